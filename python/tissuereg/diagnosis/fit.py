"""The nonlinear fit of a model with causes: Gauss-Newton, and evidence by Laplace's approximation.

    minimise 1/2 |C0^-1/2 L^-1 (y - f(x))|^2 + 1/2 |(x - mean) / deviation|^2

over x, the logarithm of the modulus followed by the free parameters (`FreeParameters`) of all causes; y are the
measured numbers, f(x) those predicted. L^-1 whitens by the noise; the other nuisances are integrated out in C0. The
Jacobian comes from difference quotients, that of the start in part from a similar model; Broyden's update carries it
from step to step. With H the Hessian in units of the prior deviations, the log evidence is
-objective - 1/2 log det H - log(number of discrete choices).
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES, FreeParameters, Values, Variant
from tissuereg.diagnosis.causes.base import Mixture
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Null, slices_of
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.predictor import NO_ANSWER, Solved
from tissuereg.experiment.effects import Effect


@dataclass(frozen=True, eq=False)
class FitTarget:
    """The data and the believed model that all fits to one experiment share, with noise and nuisances.

    `correction`: of the discretisation error; `null`: covariance of noise and of all nuisances but the modulus, which
    is fitted. The layout of `bench` holds the data.
    """

    bench: Bench
    noise: Noise
    correction: Correction
    null: Null

    def white(self, flat: FloatArray) -> FloatArray:
        """Return differences (..., size) of data and predictions, given in mm and mN, whitened by the noise alone."""
        return self.noise.whitened(flat, self.bench.layout)

    def residual(self, prediction: FloatArray) -> FloatArray:
        """Return measured minus predicted numbers (size,), whitened by the noise alone; 0 where none was measured."""
        layout = self.bench.layout
        return self.white(np.where(layout.seen, layout.measured - prediction, 0.0))

    def slopes(self, found: "Fit") -> FloatArray:
        """Return the changes (k, size) by one prior deviation of each parameter of a fit, whitened by the noise."""
        return self.white(found.jacobian) * found.deviation[:, None]

    def scales_forces(self, ids: Iterable[str]) -> bool:
        """Return whether a factor on the modulus only scales forces, in a model with the causes of these ids."""
        return self.bench.scales_forces and not any(CAUSES[name].absolute for name in ids)


@dataclass(frozen=True, eq=False)
class FittedCause:
    """One cause in a fit: its `id`, and its `free_parameters` with their normal priors."""

    id: str
    free_parameters: FreeParameters


def effects_of(parts: Sequence[FittedCause], x: FloatArray, young: float) -> tuple[Effect, ...]:
    """Return the effects of causes at parameters `x` (k,) of a model with them; `young`: modulus, kPa."""
    return tuple(
        effect
        for part, mine in zip(parts, slices_of(len(part.free_parameters.start) for part in parts), strict=True)
        for effect in part.free_parameters.effects(x[mine], young)
    )


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model with causes, fitted to data.

    `parts`: the causes in the model; empty for the believed model; `x` (k,): logarithm of the modulus, or of a factor
    on it, then the free parameters of all causes; `covariance` (k, k): its posterior covariance (Laplace).
    """

    parts: tuple[FittedCause, ...]
    x: FloatArray
    covariance: FloatArray

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the causes in the model, in their order."""
        return tuple(part.id for part in self.parts)

    def slices(self) -> list[slice]:
        """Return for every cause the slice of `x` that holds its parameters."""
        return slices_of(len(part.free_parameters.start) for part in self.parts)


@dataclass(frozen=True, eq=False)
class Fit(FittedModel):
    """A model fitted to the data of a body; its first parameter is the logarithm of a factor on the modulus.

    `mean`, `deviation` (k,): prior mean and standard deviation of x; `prediction` (size,): of all measured numbers,
    corrected for the discretisation error, mm and mN; `jacobian` (k, size): its derivative by x; `residual` (size,):
    measured minus predicted, whitened by the noise alone; 0 where nothing was measured; `objective`: minimum of half
    the squared residual, whitened by nuisances too, plus half the squared distance of x from its prior mean in prior
    deviations, nats; `log_evidence`: nats, up to a constant of all fits to the same data; `choices`: number of discrete
    hypotheses among which these causes were chosen.
    """

    mean: FloatArray
    deviation: FloatArray
    prediction: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    objective: float
    log_evidence: float
    choices: int = 1

    @property
    def near(self) -> "Near":
        """What the fit of a similar model begins from, without its equilibria."""
        return Near(self.x, self.jacobian)

    def young(self, believed: float) -> float:
        """Return the fitted modulus in kPa; `believed`: believed modulus, kPa."""
        return believed * float(np.exp(self.x[0]))

    def effects(self, believed: float) -> tuple[Effect, ...]:
        """Return the effects of all causes at the fitted parameters; `believed`: believed modulus, kPa."""
        return effects_of(self.parts, self.x, self.young(believed))

    def values(self, number: int, believed: float) -> tuple[Values, Values]:
        """Return the physical parameters of the cause of a number and their standard deviations, both by key.

        `believed`: believed modulus, kPa. Physical parameters may be nonlinear functions of the fitted ones: each
        principal axis of the fitted covariance is followed by one deviation to both sides; half the sum of the squared
        changes is the variance.
        """
        values, mine, young = self.parts[number].free_parameters.values, self.slices()[number], self.young(believed)
        centre, units = values(self.x[mine], young), self.deviation[mine]
        power, axes = np.linalg.eigh(self.covariance[mine, mine] / np.outer(units, units))
        axes = (np.sqrt(np.maximum(power, 0.0)) * axes * units[:, None]).T
        moved = [values(self.x[mine] + axis, young) for axis in (*axes, *-axes)]
        spread: Values = {}
        for key, value in centre.items():
            if not _is_text(value):
                changes = (np.asarray(other[key], float) - np.asarray(value, float) for other in moved)
                spread[key] = np.sqrt(sum((0.5 * one**2 for one in changes), np.zeros(np.shape(value)))).tolist()
        return centre, spread


@dataclass(frozen=True, eq=False)
class Near:
    """A fitted model from which the fit of a similar one begins, whose first j parameters are the same.

    `x` (j,): its parameters; `jacobian` (j, size): guess of the derivatives by them; `solved`: its equilibria, if
    known.
    """

    x: FloatArray
    jacobian: FloatArray
    solved: Solved | None = None


def near_to(target: FitTarget, found: Fit) -> Near:
    """Return what fits of models with further causes begin from; `found`: fit without these."""
    solver = _FitSolver(target, found.parts)
    if target.bench.predictor.goes_through_time(found.effects(target.bench.young)):
        # A fit that reached this model by steps from a neighbour may have no equilibrium that is found at once.
        with suppress(*NO_ANSWER):
            solver.start_from(found.x, threads=None)
    return replace(found.near, solved=solver.near)


def fit(
    target: FitTarget,
    parts: Sequence[FittedCause],
    *,
    start: FloatArray | None = None,
    choices: int = 1,
    least: float = -np.inf,
    near: Near | None = None,
) -> Fit | None:
    """Return the fit of a model with causes to the data; None where there is no equilibrium at the start.

    `parts`: the causes; empty for the believed model; `start` (k,): first guess of x; by default that of `near`, a
    similar model, and the first guess that the further causes themselves have; `choices`: number of discrete hypotheses
    among which these were chosen; its logarithm is subtracted from the evidence; `least`: log evidence, in nats, below
    which a fit is of no use. A fit that is not expected to reach it ends early, away from its optimum or with an
    approximate Jacobian.
    """
    limits, solver = target.bench.settings.fit, _FitSolver(target, tuple(parts), near)
    x = solver.start if start is None else start.copy()
    prediction = solver.predict(x)
    if prediction is None and start is None and near is None:
        # Half-way to the prior mean the effects are smaller.
        x = 0.5 * (x + solver.mean)
        prediction = solver.predict(x)
    if prediction is None:
        return None
    solver.start_from(x)
    objective, reduced = solver.objective(x, prediction)
    # The derivative by a modulus that only scales forces is known exactly.
    exact = near is None or len(near.x) <= int(solver.scales)
    jacobian, own, shown, excess = solver.jacobian(x, prediction, near), exact, False, -np.inf
    slopes = solver.reduced(jacobian)
    for remaining in reversed(range(limits.most_iterations)):
        step = solver.step(x, slopes, reduced)
        # How much evidence is lacking.
        excess, whole = least - solver.log_evidence(objective, slopes, choices), solver.predicted_decrease(step, slopes)
        if exact and excess > limits.further_gains * whole:
            break
        cut = min(1.0, limits.longest / max(float(np.abs(step / solver.deviation).max()), 1e-12))
        step *= cut
        gained, taken, was_exact = 0.0, cut, exact
        for share in limits.shares if cut * cut * whole > limits.least_predicted else ():
            trial = solver.predict(x + share * step)
            if trial is None:
                continue
            value, rest = solver.objective(x + share * step, trial)
            if value < objective:
                gained, taken = objective - value, share * cut
                jacobian = solver.updated(jacobian, share * step, trial - prediction)
                exact = False
                x, prediction, objective, reduced = x + share * step, trial, value, rest
                solver.start_from(x)
                break
            if value < objective + limits.least_gain:
                # A shorter step would hardly decrease it further.
                break
        excess -= gained
        expected = taken * (2.0 - taken) * whole
        right = was_exact or abs(gained - expected) <= limits.as_expected * max(expected, limits.least_gain)
        shown = shown or (right and gained >= limits.least_gain)
        # What a Jacobian that is in part that of the similar model may hide, once a step has shown that it is right.
        hidden = 0.0 if own else limits.borrowed + whole if shown else np.inf
        if gained < limits.least_gain:
            if exact or excess > hidden:
                break
            jacobian, exact, own = solver.jacobian(x, prediction), True, True
        elif excess > min(remaining, limits.further_gains) * gained:
            # Gains decrease from step to step: after a step with an exact Jacobian, or one that gained what its
            # Jacobian predicts, the fit will not reach the limit.
            if excess > hidden + (min(remaining, limits.further_gains) if right else remaining) * gained:
                break
            jacobian, exact, own = solver.jacobian(x, prediction), True, True
        slopes = solver.reduced(jacobian)
    if not own and excess <= 0.0:
        jacobian = solver.jacobian(x, prediction)
        slopes = solver.reduced(jacobian)
    covariance = np.asarray(np.linalg.inv(solver.information(slopes)), np.float64)
    residual, evidence = target.residual(prediction), solver.log_evidence(objective, slopes, choices)
    prior = (solver.mean, solver.deviation)
    return Fit(solver.parts, x, covariance, *prior, prediction, jacobian, residual, objective, evidence, choices)


def best_start(target: FitTarget, parts: Sequence[FittedCause], near: Near) -> FloatArray:
    """Return the best first guess of the fit with a further cause: that with the smallest objective.

    `parts`: all causes, the further one last; `near`: the fit without it. Result: (j + n_parameters,), the parameters
    of that fit and then one of the first guesses of the further cause; its default one where it offers no others or
    none of them has an equilibrium.
    """
    free_parameters = parts[-1].free_parameters
    tried = [np.concatenate([near.x, start]) for start in free_parameters.guesses]
    if len(tried) == 1:
        return tried[0]
    solver = _FitSolver(target, tuple(parts), near)

    def objective(x: FloatArray) -> float:
        prediction = solver.predict(x)
        return np.inf if prediction is None else solver.objective(x, prediction)[0]

    return tried[int(np.argmin(target.bench.side_by_side(objective, tried)))]


def choices_of(cause: str, variants: Sequence[Variant]) -> int:
    """Return how many discrete hypotheses a cause has between which its free parameters cannot move; at least 1."""
    keys = CAUSES[cause].discrete
    return max(1, len({tuple(str(v.settings.get(key)) for key in keys) for v in variants}))


def predicted(target: FitTarget, found: Fit, *, without: int) -> FloatArray:
    """Return the prediction (size,), mm and mN, of a fit without one of its causes.

    `without`: number of the cause. Raises as `at_believed_modulus`.
    """
    others = (*found.parts[:without], *found.parts[without + 1 :])
    x, solver = np.delete(found.x, np.r_[found.slices()[without]]), _FitSolver(target, others)
    return target.correction.corrected(solver.uncorrected(x), solver.factor(x))


def at_believed_modulus(target: FitTarget, found: Fit) -> tuple[tuple[Effect, ...], FloatArray]:
    """Return the effects of a fit's causes, and the prediction with them on the user's mesh, at the believed modulus.

    The prediction is (size,), in mm and mN, and not corrected for the discretisation error. Raises `ConvergenceError`
    if a frame has no equilibrium; `ExperimentError`, `MaterialError` or `SupportError` if an effect does not apply.
    """
    x = found.x.copy()
    x[0] = 0.0
    effects = replace(found, x=x).effects(target.bench.young)
    return effects, _FitSolver(target, found.parts).uncorrected(x)


class _FitSolver:
    """Objective, Jacobian and step of one fit with the causes `parts`, for parameters (k,) as in `FittedModel.x`."""

    def __init__(self, target: FitTarget, parts: tuple[FittedCause, ...], near: Near | None = None) -> None:
        self.target = target
        self.parts = parts
        self.slices = slices_of(len(part.free_parameters.start) for part in parts)
        # The first parameter is the logarithm of the modulus over the believed one; the modulus' prior is log-normal.
        self.start = np.concatenate([[0.0], *(part.free_parameters.start for part in parts)])
        if near is not None:
            self.start[: len(near.x)] = near.x
        self.mean = np.concatenate([[0.0], *(part.free_parameters.mean for part in parts)])
        spread = target.bench.young_spread
        self.deviation = np.concatenate([[spread], *(part.free_parameters.deviation for part in parts)])
        self.steps = np.concatenate([[0.02], *(part.free_parameters.step for part in parts)])
        self.scales = target.scales_forces(part.id for part in parts)
        self.force = ~target.bench.layout.of_markers()
        self.near: Solved | None = None if near is None else near.solved

    def predict(self, x: FloatArray) -> FloatArray | None:
        try:
            found = self.uncorrected(x)
        except NO_ANSWER:
            return None
        return self.target.correction.corrected(found, self.factor(x))

    def uncorrected(self, x: FloatArray) -> FloatArray:
        """Return the prediction (size,) on the user's mesh for parameters (k,), mm and mN."""
        factor = self.factor(x)
        total = np.zeros(len(self.force))
        for part, mine in zip(self.parts, self.slices, strict=True):
            if part.free_parameters.columns is not None:
                total += x[mine] @ part.free_parameters.columns
        for weight, effects in self.mixture(x):
            total += weight * self.body(effects, factor)
        return np.where(self.force, factor * total, total) if self.scales else total

    def body(self, effects: Sequence[Effect], factor: float) -> FloatArray:
        """Return the prediction (size,) on the user's mesh, mm and mN; `factor`: modulus over the believed one."""
        bench = self.target.bench
        if not effects and (self.scales or factor == 1.0):
            return bench.base
        young = None if self.scales else factor
        return bench.predictor.predict(effects, young=young, threads=1, near=self.near)

    def factor(self, x: FloatArray) -> float:
        """Return the modulus over the believed one, for parameters (k,); the first of them is its logarithm."""
        return float(np.exp(np.clip(x[0], -3.0, 3.0)))

    def mixture(self, x: FloatArray) -> Mixture:
        """Return weights of sum 1 and the sets of effects to average over; causes with linear columns are left out."""
        young = self.target.bench.young * (1.0 if self.scales else self.factor(x))
        mixture: Mixture = [(1.0, ())]
        for part, mine in zip(self.parts, self.slices, strict=True):
            if part.free_parameters.columns is None:
                own = part.free_parameters.mixture(x[mine], young)
                mixture = [(a * b, (*before, *more)) for a, before in mixture for b, more in own if b > 0.0]
        return mixture

    def start_from(self, x: FloatArray, threads: int | None = 1) -> None:
        """Let the following solutions start from the equilibria for parameters (k,)."""
        if effects := max(self.mixture(x), key=lambda one: one[0])[1]:
            young = None if self.scales else self.factor(x)
            self.near = self.target.bench.predictor.solved(effects, young=young, threads=threads, near=self.near)

    def objective(self, x: FloatArray, prediction: FloatArray) -> tuple[float, FloatArray]:
        reduced = self.target.null.reduced(self.target.residual(prediction))
        prior = (x - self.mean) / self.deviation
        return float(0.5 * reduced @ reduced + 0.5 * prior @ prior), reduced

    def jacobian(self, x: FloatArray, prediction: FloatArray, near: Near | None = None) -> FloatArray:
        """Return the derivative (k, size) of the corrected prediction, mm and mN, its first rows from `near`."""
        rows, first = np.zeros((len(x), len(prediction))), int(self.scales)
        if near is not None:
            rows[: len(near.x)] = near.jacobian
            first = max(first, len(near.x))
        if self.scales:
            rows[0] = np.where(self.force, prediction, 0.0)

        def moved(i: int) -> FloatArray:
            for side in (1.0, -1.0):
                nudged = x.copy()
                nudged[i] += side * self.steps[i]
                trial = self.predict(nudged)
                if trial is not None:
                    return np.asarray((trial - prediction) / (side * self.steps[i]))
            return np.zeros(len(prediction))

        if first < len(x):
            rows[first:] = self.target.bench.side_by_side(moved, range(first, len(x)))
        return rows

    def updated(self, jacobian: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
        """Return Broyden's update of a Jacobian (k, size) by a step (k,) and the change (size,) that it made."""
        along = step / self.deviation
        weights = along / (self.deviation * float(along @ along))
        return np.asarray(jacobian + np.outer(weights, change - step @ jacobian))

    def reduced(self, rows: FloatArray) -> FloatArray:
        """Return derivatives (k, size) of predictions, given in mm and mN, whitened by noise and nuisances."""
        return self.target.null.reduced(self.target.white(rows))

    def predicted_decrease(self, step: FloatArray, slopes: FloatArray) -> float:
        """Return the decrease of the objective, nats, that whitened derivatives (k, size) predict for a step (k,)."""
        prior, along = step / self.deviation, step @ slopes
        return float(0.5 * along @ along + 0.5 * prior @ prior)

    def information(self, slopes: FloatArray) -> FloatArray:
        """Return the Hessian (k, k) of the objective, by Gauss and Newton, from whitened derivatives (k, size)."""
        return slopes @ slopes.T + np.diag(1.0 / self.deviation**2)

    def log_evidence(self, objective: float, slopes: FloatArray, choices: int) -> float:
        """Return the log evidence of a fit, nats, from its objective and whitened derivatives (k, size)."""
        inner = self.information(slopes) * self.deviation[:, None] * self.deviation
        return -objective - 0.5 * float(np.linalg.slogdet(inner)[1]) - float(np.log(choices))

    def step(self, x: FloatArray, slopes: FloatArray, reduced: FloatArray) -> FloatArray:
        gradient = slopes @ reduced - (x - self.mean) / self.deviation**2
        return np.asarray(np.linalg.solve(self.information(slopes), gradient))


def _is_text(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and isinstance(value[0], str)
    return isinstance(value, str | bool)
