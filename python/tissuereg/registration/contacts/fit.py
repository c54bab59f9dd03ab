"""Search for the contacts that explain the data: linearise, sample, solve, until the body meets the measurements.

One such round is called a pass: it takes the sensitivities of all observations at the present equilibrium, samples
which contacts explain the residual, and solves the equilibrium under the mean load. Model error enters the sampling
only as noise of the data: as unknowns of its own it would explain part of the motion, which the solved equilibrium
would then lack. What changes of the stiffness and unexplained displacements move is added to it. Points without labels
are matched anew in every pass: first fewer of them, in more passes, then all.
"""

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.clock import Clock
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.linear import AtBody, Linearisation
from tissuereg.registration.contacts.measured import ObservedData
from tissuereg.registration.contacts.observations import LinearObservations
from tissuereg.registration.contacts.settings import DISCRETISATION, ContactSettings, PassSettings
from tissuereg.registration.contacts.state import BodyState, RigidMotion
from tissuereg.registration.contacts.tangent import Tangent

Samples = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class _Pass:
    """One round of linearising, sampling and solving: its end, its samples, and the linear problem at its start.

    `state`: equilibrium at its end; `samples`: samples of the posterior (contacts, sizes of the families of causes,
    wrong markers); `at`: the body and its observations linearised at its start; `residual`: root mean square residual
    at its end, in standard deviations; `predicted`: the linear model's prediction of it; `misfit`: mean over the
    samples of the squared Mahalanobis length of the innovation.
    """

    state: BodyState
    samples: Samples
    at: AtBody
    residual: float
    predicted: float
    misfit: float

    def ended_as_predicted(self, margin: float) -> bool:
        """Return whether the residual is below the predicted one plus `margin`, each in standard deviations."""
        return self.residual < self.predicted + margin


@dataclass(frozen=True)
class _Residuals:
    """Root mean square residual after a round, and the linear model's prediction of it, in standard deviations."""

    residual: float
    predicted: float


@dataclass(frozen=True, eq=False)
class ContactFit:
    """The contacts that were found, and the equilibrium under them.

    Attributes
    ----------
    columns : Columns
        All possible causes of motion (forces on patches, body force, rigid motion, ...), one column each.
    state : BodyState
        The equilibrium under the posterior mean of the load, or as near to it as a step reduced the residual.
    tangent : Tangent
        The linearised equilibrium there, or at the start of the last step if that ended as its linear model predicted.
    observations : LinearObservations
        Observations with their responses to the causes, linearised at the same place as `tangent`.
    sampler : _core.Contacts
        Compiled sampler with prior and data at that linearisation.
    samples : tuple of three ndarray of int64
        Samples of the posterior: patch and size of each contact, (n_samples, n_slots, 2), -1 for none; candidate size
        of each family of causes, (n_samples, n_families); whether each marker that was seen is wrong, (n_samples,
        n_seen), 0 or 1, without columns if outliers are weighted down instead.
    wrong : ndarray of float64, shape (n_markers,)
        Probability that each marker is wrong; zero for markers that were not seen.
    misfit : float
        Mean over samples of the squared Mahalanobis length of the innovation at the end.
    residual_rms : list of float
        Root mean square residual after each round, in standard deviations.
    counters : collections.Counter
        Numbers of factorisations, right-hand sides, solves, sweeps of the chains, and other work.
    """

    columns: Columns
    state: BodyState
    tangent: Tangent
    observations: LinearObservations
    sampler: Any
    samples: Samples
    wrong: FloatArray
    misfit: float
    residual_rms: list[float]
    counters: Counter[str]


@dataclass(eq=False)
class Passes:
    """The loop of linearising, sampling and solving, with its data and settings; one round is called a pass.

    `columns`: possible causes of motion; `observed`: data; `material`: material of the body; `settings`: prior and
    Markov chains; `rng`: source of all random numbers; `threads`: threads to use, 0 takes all cores; `clock`: records
    the times of the stages and is notified of every pass; `before`: samples from which the chains of the first pass
    continue, not used if points are matched anew; None to start them afresh; `kept`: a linearised equilibrium near the
    start, used in the first pass in place of the one at the start; None to make it; `counters`: counts factorisations,
    right-hand sides and other work.
    """

    columns: Columns
    observed: ObservedData
    material: Material
    settings: ContactSettings
    rng: np.random.Generator
    threads: int
    clock: Clock
    before: Samples | None = None
    kept: Tangent | None = None
    counters: Counter[str] = field(default_factory=Counter)

    @property
    def steps(self) -> PassSettings:
        """Settings of the loop: when a step is accepted, and when the passes end."""
        return self.settings.steps

    @cached_property
    def linear(self) -> Linearisation:
        """Object that linearises the body and its observations; its work is added to `counters`."""
        return Linearisation(
            self.columns, self.material, self.settings, self.threads, self.clock, self.counters, self.kept
        )

    def run(self, start: BodyState) -> ContactFit:
        """Return the contacts and the equilibrium that explain the data, found from a start in equilibrium.

        `start`: the body under the believed load, with zero coefficients of the causes, or the end of an earlier fit.
        Result: the best pass, with a linearisation at its end. Raises `ConvergenceError` if no pass is allowed, or if
        the body has no tangent at the start.
        """
        full = self.observed
        best: tuple[_Pass, list[float]] | None = None
        for width in self.steps.widths if full.rematches else (0.0,):
            found = self._from(start, self._stages(full, width))
            if best is None or found[0].residual < best[0].residual:
                best = found
            if full.outliers(found[0].state) < self.steps.most_outliers:
                break
        if best is None:
            message = "at least one width must be tried"
            raise ConvergenceError(message, where="load")
        last, history = best
        self.observed = full
        if not self._ends_here(last, full):
            last = self._settled(last)
        return self._fit(last, self._at_end(last, full), history)

    def _ends_here(self, last: "_Pass", full: ObservedData) -> bool:
        """Return whether the linear problem at the start of a pass serves at its end."""
        margin = self.steps.as_predicted if self.before is None else self.steps.as_predicted_on
        return last.ended_as_predicted(margin) and not full.rematches

    def _settled(self, made: "_Pass") -> "_Pass":
        """Return a pass with its end so near to equilibrium that it can be linearised, where it only came close."""
        if self.before is None:
            return made
        state = made.state
        try:
            found = made.at.tangent.linearised.solve_near(
                self.columns.load(state.coefficients),
                springs=self.columns.springs,
                tolerance=DISCRETISATION.tolerance,
                max_iterations=self.steps.most_iterations,
                threads=self.threads,
            )
        except ConvergenceError:
            return made  # of which there is then no tangent
        return replace(made, state=replace(state, displacement=found.all_displacement))

    def _at_end(self, last: "_Pass", full: ObservedData) -> AtBody:
        """Return the linear problem at the end of a pass, or at its start if the step ended as predicted.

        `last`: the pass (one round of the fit); `full`: all data. If points are matched to the surface, the problem is
        always made at the end. The problem at the start is also returned if there is no tangent at the end.
        """
        if self._ends_here(last, full):
            return last.at
        try:
            return self.linear.at(last.state, full)
        except ConvergenceError:
            return last.at

    def _from(self, start: BodyState, stages: list[tuple[ObservedData, int]]) -> tuple["_Pass", list[float]]:
        """Return the pass with the smallest residual of the last stage, and the residual after each pass of all stages.

        A pass is one round of the fit. `start`: equilibrium at the beginning; `stages`: data to be met one after the
        other, each with its largest number of passes. Residuals are root mean squares in standard deviations. Raises
        `ConvergenceError` if there is no stage.
        """
        last, state, history = None, start, list[float]()
        samples = None if self.observed.weighed or self.observed.rematches else self.before
        for observed, most in stages:
            if self.observed.weighed != observed.weighed:
                samples = None  # samples of markers with indicators do not fit weights
            self.observed = observed
            last, reached = self._approach(state, samples, most)
            state, samples = last.state, last.samples
            history += reached
        if last is None:
            message = "at least one pass must be allowed"
            raise ConvergenceError(message, where="max_passes")
        return last, history

    def _stages(self, full: ObservedData, width: float) -> list[tuple[ObservedData, int]]:
        """Return the data of each stage of the search with its largest number of passes: few points first, then all.

        `full`: all data; `width`: length, as a share of the extent, within which matching errors of the first stage are
        correlated. Markers alone come first; without points of a surface there is one stage with all data.
        """
        if not full.rematches:
            return [(full, self.settings.max_passes)]
        stages = [(full.coarser(width), self.steps.coarse_passes), (full, self.steps.fine_passes)]
        # Markers have labels: they bring the body close before points are matched.
        return stages if full.markers is None else [(ObservedData.of(full.markers), self.steps.marker_passes), *stages]

    def _approach(self, state: BodyState, samples: Samples | None, most: int) -> tuple["_Pass", list[float]]:
        """Return the pass (round of the fit) with the smallest residual of at most `most`, and the residual after each.

        `state`: equilibrium to begin at; `samples`: samples from which the chains continue, or None. Residuals are root
        mean squares in standard deviations. Raises `ConvergenceError` if there is no tangent at the first equilibrium.
        """
        reached: list[_Residuals] = []
        closest: _Pass | None = None
        while len(reached) < max(most, 1) and not self._ended(reached):
            try:
                made = self._one_pass(state, samples)
            except ConvergenceError:
                # There is no tangent at a limit point: use the passes so far.
                if closest is None:
                    raise
                break
            reached.append(_Residuals(made.residual, made.predicted))
            state, samples = made.state if self._ended(reached) else self._settled(made).state, made.samples
            # Past a limit point of the load passes may lead away again: the best one is kept, and only that one, since
            # each holds a factor.
            if closest is None or made.residual < closest.residual:
                closest = made
            del made
            most_passes = (
                self.steps.coarse_passes + self.steps.fine_passes
                if self.observed.rematches
                else self.settings.max_passes
            )
            self.clock.passed(min(self.counters["passes"], most_passes), most_passes)
        assert closest is not None  # the loop runs once at least
        return closest, [one.residual for one in reached]

    def _one_pass(self, state: BodyState, samples: Samples | None) -> "_Pass":
        """Return the pass (linearise, sample, solve) that begins at an equilibrium.

        `state`: the equilibrium; `samples`: samples from which its chains continue, or None to start them afresh.
        """
        at = self.linear.at(state, self.observed)
        drawn = self._sample(at.sampler, samples)
        with self.clock.stage("solve"):
            wanted, misfit = self._mean(at, drawn)
            predicted = _predicted_residual(at.observations, wanted, drawn)
            reached = self._solve(at, drawn, state, wanted)
        return _Pass(reached, drawn, at, self.residual_rms(reached, drawn), predicted, misfit)

    def observations(self, state: BodyState) -> LinearObservations:
        """Return the observations linearised at a body, with their responses to all causes, (n_obs, n_columns), mm."""
        tangent = self.linear.tangent(state)
        return self.linear.observations(
            tangent, self.observed.read(state, tangent.moved), state.coefficients, self.observed
        )

    def _sample(self, core: Any, before: Samples | None) -> Samples:
        settings = self.settings
        powers, n_chains = settings.powers_again, settings.n_chains
        if before is None:
            powers, n_chains = settings.powers, settings.n_chains_first
        elif self.before is not None:
            powers, n_chains = settings.powers_on, settings.n_chains_on
        count = core.n_uniforms(len(powers), settings.n_local, settings.n_level)
        with self.clock.stage("sample"):
            samples, _, counters = core.run(
                self.rng.random((n_chains, count)),
                powers=list(powers),
                n_kept=settings.n_kept,
                sharpness=settings.sharpness,
                n_local=settings.n_local,
                n_level=settings.n_level,
                starts=None
                if before is None
                else [np.ascontiguousarray(a[settings.n_kept - 1 :: settings.n_kept]) for a in before],
                threads=self.threads,
            )
        self.counters["passes"] += 1
        self.counters["sweeps"] += n_chains * len(powers)
        for name, value in counters.items():
            self.counters[name if name != "factorisations" else "small_factorisations"] += value
        return tuple(samples)

    def _mean(self, at: AtBody, samples: Samples) -> tuple[FloatArray, float]:
        """Return mean coefficients over samples, (n_columns,), and the innovation's mean squared Mahalanobis length."""
        no_points = np.zeros((0, self.columns.n_columns))
        found = at.sampler.moments(list(samples), no_points, threads=self.threads)
        return found[0], float(found[5])

    def _solve(self, at: AtBody, samples: Samples, state: BodyState, wanted: FloatArray) -> BodyState:
        """Return the equilibrium under the `wanted` coefficients, or after a shorter step towards them that helps more.

        `at`: the linear problem at `state`, the present equilibrium; `samples`: samples of the posterior; `wanted`
        (n_columns,): coefficients of the causes. A step is halved until it reduces the residual enough. Result: `state`
        itself if no step finds an equilibrium or, where points are matched, none reduces the residual.
        """
        steps, matched = self.steps, not self.observed.rematches
        share, decrease = 1.0, steps.decrease if matched else steps.decrease_unmatched
        # Points are matched anew, but keep the weights for which the step was predicted.
        std = self.observed.read(state).std if self.observed.rough else None
        before = self.residual_rms(state, samples, std)
        best: tuple[float, BodyState] | None = None
        while share > (steps.shortest if matched or best is None else steps.shortest_unmatched):
            found = self._towards(at.tangent, state, state.coefficients + share * (wanted - state.coefficients))
            if found is not None:
                residual = self.residual_rms(found, samples, std)
                if best is None or residual < best[0]:
                    best = (residual, found)
                enough = steps.good_enough * self.settings.fit_limit if matched else 0.0
                if residual < max((1.0 - decrease * share) * before, enough):
                    return found
            share *= 0.5
            self.counters["halved_steps"] += 1
        if best is None or (best[0] >= before and self.observed.rematches):
            # No load on the way has an equilibrium, or none reduces the residual: the next samples may.
            self.counters["stuck_passes"] += 1
            return state
        return best[1]

    def _towards(self, tangent: Tangent, state: BodyState, coefficients: FloatArray) -> BodyState | None:
        """Return the equilibrium under coefficients (n_columns,) of the causes; None if none is found.

        `tangent`: linearised equilibrium at `state`, from which the solver starts. The rigid motion among the causes is
        applied to the frame; of a body without supports its coefficients are then set to zero.
        """
        try:
            load = self.columns.load(coefficients)
            found = tangent.linearised.solve_near(
                load,
                springs=self.columns.springs,
                tolerance=DISCRETISATION.tolerance if self.before is None else _tolerance_on(state, coefficients),
                max_iterations=self.steps.most_iterations,
                threads=self.threads,
            )
        except ConvergenceError:
            return None
        self.counters["solves"] += 1
        self.counters["iterations"] += int(found.report["iterations"])
        turned = self.columns.frame(coefficients)
        parts = self.columns.beside(coefficients, tangent.by_stiffness)
        beside = sum(parts.values(), np.zeros((self.columns.body.mesh.n_nodes, 3)))
        if not self.columns.body.supports.moves:
            # A drift is small and keeps its prior: its coefficients are relative to no motion.
            frame = RigidMotion.still().followed_by(turned, self.columns.rigid)
            return BodyState(coefficients, found.all_displacement, frame, beside)
        frame = state.frame.followed_by(turned, self.columns.rigid)
        kept = self.columns.without_frame(coefficients)
        return BodyState(kept, found.all_displacement, frame, beside)

    def residual_rms(self, state: BodyState, samples: Samples, std: FloatArray | None = None) -> float:
        """Return the root mean square residual of a body, in standard deviations.

        `state`: the body; `samples`: posterior samples, which give each marker's probability not to be wrong, the
        weight of its observations; `std` (n_obs,): standard deviations to use without weights, mm; by default those at
        the body, with weights.
        """
        reading = self.observed.read(state)
        if std is not None:
            return float(np.sqrt(np.mean((reading.residual / std) ** 2)))
        weights = np.ones(len(reading.cost))
        for group, wrong in zip(reading.groups, samples[2].mean(axis=0), strict=True):
            weights[group] = max(1.0 - wrong, 1e-6)
        return float(np.sqrt(np.average(reading.cost, weights=weights)))

    def _ended(self, reached: list["_Residuals"]) -> bool:
        """Return whether the data are met as the linear model predicted, or passes no longer improve the fit.

        `reached`: residual of each pass so far and its prediction, in standard deviations.
        """
        # A first pass from samples of the moment before is no first look.
        if len(reached) < (2 if self.before is None else 1):
            return False
        residual = reached[-1].residual
        if self.observed.rematches:
            before = reached[-2].residual if len(reached) > 1 else np.inf
            few = len(reached) < self.steps.least_rough and self.observed.rough and residual > self.settings.fit_limit
            return not few and residual > (1.0 - self.steps.settled) * before
        met = residual < self.settings.fit_limit and residual < reached[-1].predicted + self.settings.promise_margin
        residuals = [one.residual for one in reached]
        return met or (len(reached) > 3 and min(residuals[-2:]) > 0.95 * min(residuals[:-2]))

    def _fit(self, last: "_Pass", at: AtBody, history: list[float]) -> ContactFit:
        misfit = last.misfit if at is last.at else self._mean(at, last.samples)[1]
        wrong = self._wrong(last.state, last.samples)
        return ContactFit(
            self.columns,
            last.state,
            at.tangent,
            at.observations,
            at.sampler,
            last.samples,
            wrong,
            misfit,
            history,
            self.counters,
        )

    def _wrong(self, state: BodyState, samples: Samples) -> FloatArray:
        """Return the probability that each marker is wrong, (n_markers,); zero for markers that were not seen.

        `state`: the body at the end; `samples`: posterior samples.
        """
        markers = self.observed.markers
        if markers is None:
            return np.zeros(self.observed.n_markers)
        wrong = np.zeros(self.observed.n_markers)
        found = samples[2].mean(axis=0)
        if self.observed.weighed:
            spread = self.settings.wrong_share * self.columns.body.mesh.extent
            found = markers.wrong(state, float(np.log(self.settings.wrong_odds)), spread)
        wrong[np.unique(markers.rows // 3)] = found
        return wrong


def _tolerance_on(state: BodyState, coefficients: FloatArray) -> float:
    """Return the relative residual that is allowed where a body goes on from a state to coefficients (n_columns,)."""
    change = np.linalg.norm(coefficients - state.coefficients) / max(float(np.linalg.norm(coefficients)), 1e-300)
    return max(DISCRETISATION.tolerance, DISCRETISATION.tolerance_on * min(float(change), 1.0))


def _predicted_residual(problem: LinearObservations, coefficients: FloatArray, samples: Samples) -> float:
    """Return the root mean square residual, in standard deviations, that the linear model predicts.

    `problem`: linearised observations; `coefficients` (n_columns,): coefficients of the causes; `samples`: posterior
    samples, which give each marker's probability not to be wrong, the weight of its observations.
    """
    residual = (problem.innovation - problem.responses @ coefficients) ** 2 / problem.variances
    weights = np.ones(len(residual))
    for group, wrong in zip(problem.groups, samples[2].mean(axis=0), strict=True):
        weights[group] = max(1.0 - wrong, 1e-6)
    return float(np.sqrt(np.average(residual, weights=weights)))


def start_of(
    columns: Columns, material: Material, simulation: FloatArray | None, frame: RigidMotion, threads: int
) -> BodyState:
    """Return the body under the believed load alone: in equilibrium, with zero coefficients of all causes.

    `columns`: possible causes, with the believed load; `material`: material of the body; `simulation` (n_element_nodes,
    3) or None: the displacement under the believed load, mm, if it is known; `frame`: initial rigid motion from the
    body's frame to the tracker's; `threads`: threads to use, 0 takes all cores. Result: the body at rest if no load is
    believed. Raises `ConvergenceError` if no equilibrium is found.
    """
    zero = np.zeros(columns.n_columns)
    simulator = columns.body.simulator
    if simulation is not None:
        return BodyState(zero, simulation, frame)
    if all(part is None for part in columns.believed.values()):
        return BodyState(zero, np.zeros((simulator.body.n_nodes, 3)), frame)
    load: Load = columns.load(zero)
    found = simulator.solve(
        load, material, springs=columns.springs, tolerance=DISCRETISATION.tolerance, threads=threads
    )
    return BodyState(zero, found.all_displacement, frame)
