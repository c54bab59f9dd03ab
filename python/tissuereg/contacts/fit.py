"""From data to contacts: linearise, sample, solve, until the body meets what was seen.

A pass takes the sensitivities of all observations at the present equilibrium, samples which contacts explain what is
left, and solves the equilibrium under the mean load. What the model gets wrong enters the samples through the noise of
the data alone: as unknowns of its own it would explain away motion that the equilibrium then lacks. Points without
labels are matched anew in every pass: first fewer of them, in more passes, then all.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg._clock import Clock
from tissuereg.contacts.columns import Columns, sampler
from tissuereg.contacts.frame import Frame
from tissuereg.contacts.moment import Moment
from tissuereg.contacts.posed import MOST_KEPT, MOST_KEPT_COARSE, Basis, Posed, moving_variances, plain, projected
from tissuereg.contacts.seen import Reading, Seen
from tissuereg.contacts.settings import ContactSettings
from tissuereg.errors import ConvergenceError
from tissuereg.load import Load
from tissuereg.material import Material
from tissuereg.simulate.sensitivity import Linearised, Observation

#: Residual of an equilibrium that is linearised, over its load.
_TOLERANCE = 3e-7

#: Shortest share of a step towards the mean load.
_SHORTEST_STEP = 0.02

#: A load that takes more iterations than this is not worth the wait: a shorter step is tried.
_MOST_ITERATIONS = 150

#: A step must take away this part of what it promises, or leave the markers within this many times the limit.
_DECREASE, _GOOD_ENOUGH = 0.3, 1.5

#: The same where points without labels are matched anew: the first part of the way is the slowest.
_DECREASE_UNMATCHED = 0.01

#: And a step that is not shorter than this is taken where it brings anything.
_SHORTEST_UNMATCHED = 0.2

#: First passes that are made in any case, while the points are not met.
_LEAST_ROUGH = 4

#: Passes with markers alone, where there are any beside points.
_MARKER_PASSES = 2

#: Passes with few points at most, and with all of them.
_COARSE_PASSES, _FINE_PASSES = 8, 5

#: Shares of the extent within which first matches go wrong alike: the second is tried where the first leaves more
#: than this share of the points as outliers.
_WIDTHS, _MOST_OUTLIERS = (0.12, 0.2), 0.13

#: Matches have settled where a pass takes away less than this share.
_SETTLED = 0.05

Samples = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class ContactFit:
    """What the passes came to.

    Attributes
    ----------
    columns : Columns
        Causes.
    moment : Moment
        The equilibrium under the mean load.
    linearised : Linearised
        The tangent there.
    posed : Posed
        Data of the last pass, as the sampler has them.
    sampler : _core.Contacts
        Dictionary, prior and data of the last pass.
    samples : tuple of ndarray
        Slots, levels and wrong groups of every sample.
    wrong : ndarray of float64, shape (n_markers,)
        Probability that a marker is wrong; zero where it was not seen.
    misfit : float
        Mean over samples of the squared Mahalanobis length of the innovation at the end.
    residual_rms : list of float
        Root mean square residual after each pass, over standard deviations.
    counters : dict of str to int
        Work.
    """

    columns: Columns
    moment: Moment
    linearised: Linearised
    posed: Posed
    sampler: Any
    samples: Samples
    wrong: FloatArray
    misfit: float
    residual_rms: list[float]
    counters: dict[str, int]


@dataclass(eq=False)
class Passes:
    """The loop with what it needs.

    Parameters
    ----------
    columns : Columns
        Causes.
    seen : Seen
        Data.
    material : Material
        What the body is made of.
    settings : ContactSettings
        Prior and chains.
    rng : numpy.random.Generator
        All chance.
    threads : int
        Threads to use; 0 takes all cores.
    clock : Clock
        Gets the stages' times.
    progress : callable of (int, int), optional
        Called with passes finished and passes at most.
    """

    columns: Columns
    seen: Seen
    material: Material
    settings: ContactSettings
    rng: np.random.Generator
    threads: int
    clock: Clock
    progress: Callable[[int, int], None] | None = None
    counters: dict[str, int] = field(default_factory=dict)
    _basis: Basis | None = None

    def run(self, start: Moment) -> ContactFit:
        """Return the fit from a start in equilibrium.

        Parameters
        ----------
        start : Moment
            The body under the believed load, zero coefficients.

        Returns
        -------
        ContactFit
            With a linearisation at its end.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found even with a short step.
        """
        full = self.seen
        best: tuple[float, Moment, Samples, list[float]] | None = None
        for width in _WIDTHS if full.rematches else (0.0,):
            found = self._from(start, self._stages(full, width))
            if best is None or found[0] < best[0]:
                best = found
            if full.outliers(found[1]) < _MOST_OUTLIERS:
                break
        if best is None:
            message = "at least one width must be tried"
            raise ConvergenceError(message, where="load")
        _, moment, samples, history = best
        self.seen = full
        linearised = self._linearise(moment)
        return self._fit(moment, linearised, self._pose(linearised, moment), samples, history)

    def _from(self, start: Moment, stages: list[tuple[Seen, int]]) -> tuple[float, Moment, Samples, list[float]]:
        """Return what a start comes to: the cost left, the body, its samples and the cost after each pass."""
        moment, history = start, list[float]()
        samples: Samples | None = None
        for seen, most in stages:
            if self.seen.weighed != seen.weighed:
                samples = None  # samples of markers with indicators do not fit weights
            self.seen, self._basis = seen, None
            moment, samples, reached = self._approach(moment, samples, most)
            history += reached
        if samples is None:
            message = "at least one pass must be allowed"
            raise ConvergenceError(message, where="max_passes")
        return self.residual_rms(moment, samples), moment, samples, history

    def _stages(self, full: Seen, width: float) -> list[tuple[Seen, int]]:
        """Return the data of each stage with its passes at most."""
        if not full.rematches:
            return [(full, self.settings.max_passes)]
        stages = [(full.coarser(width), _COARSE_PASSES), (full, _FINE_PASSES)]
        # Markers have labels: they bring the body near before anything is matched.
        return stages if full.markers is None else [(Seen.of(full.markers), _MARKER_PASSES), *stages]

    def _approach(
        self, moment: Moment, samples: Samples | None, most: int
    ) -> tuple[Moment, Samples | None, list[float]]:
        """Return the closest body of at most so many passes, its samples, and what each pass left."""
        history: list[float] = []
        reached: list[tuple[Moment, Samples]] = []
        promised = 0.0
        while len(history) < most and not self._ended(history, promised):
            linearised = self._linearise(moment)
            problem, core = self._pose(linearised, moment)
            samples = self._sample(core, samples)
            with self.clock.stage("solve"):
                moment, promised = self._solve(linearised, (problem, core), samples, moment)
            history.append(self.residual_rms(moment, samples))
            reached.append((moment, samples))
            if self.progress is not None:
                most_passes = _COARSE_PASSES + _FINE_PASSES if self.seen.rematches else self.settings.max_passes
                self.progress(min(self.counters["passes"], most_passes), most_passes)
        if reached:
            # Past a limit point of the load passes may lead away again: the closest one counts.
            moment, samples = reached[int(np.argmin(history))]
        return moment, samples, history

    def linear(self, moment: Moment) -> Posed:
        """Return the data at a body with how they follow the columns."""
        return self._posed(self._linearise(moment), self.seen.read(moment), moment.coefficients)

    def _linearise(self, moment: Moment) -> Linearised:
        self._count("factorisations", 1)
        with self.clock.stage("linearise"):
            load = self.columns.load(moment.coefficients)
            simulator = self.columns.body.simulator
            return Linearised(
                simulator,
                load,
                self.material,
                moment.displacement,
                springs=self.columns.springs,
                precision="single",
                threads=self.threads,
            )

    def _pose(self, linearised: Linearised, moment: Moment) -> tuple[Posed, Any]:
        """Return the observations at a body as the sampler has them, and the sampler."""
        with self.clock.stage("match"):
            reading = self.seen.read(moment)
        problem = self._posed(linearised, reading, moment.coefficients)
        with self.clock.stage("prepare"):
            data = {
                "innovation": problem.innovation,
                "noise": np.diag(problem.variances),
                "groups": problem.groups,
            }
            return problem, sampler(self.columns, self.settings, problem.responses, data)

    def _posed(self, linearised: Linearised, reading: Reading, coefficients: FloatArray) -> Posed:
        """Return observations as they are, or, where they are many, as few that say nearly the same."""
        rigid = self.columns.rigid_rows(reading.places, reading.directions)
        if not self.seen.weighed:
            return plain(reading, self._responses(linearised, reading.rows, rigid), coefficients)
        if self._basis is None:
            every = self._responses(linearised, reading.rows, rigid)
            with self.clock.stage("prepare"):
                most = MOST_KEPT_COARSE if self.seen.rough else MOST_KEPT
                self._basis = Basis.of(reading, every, moving_variances(self.columns, self.settings), most)
            few = (self._basis.vectors / reading.std) @ every
        else:
            few = self._responses(linearised, self._basis.rows(reading), (self._basis.vectors / reading.std) @ rigid)
        return projected(reading, self._basis, few, coefficients)

    def _responses(
        self, linearised: Linearised, rows: list[tuple[IntArray, FloatArray]], rigid: FloatArray
    ) -> FloatArray:
        """Return how rows of nodes and weights follow the columns, (n_rows, n_columns)."""
        with self.clock.stage("sensitivities"):
            compliance = linearised.compliance([Observation(nodes, weights) for nodes, weights in rows])
            self._count("right_hand_sides", len(rows))
            return self.columns.responses(compliance, np.empty((0, 3)), rigid)

    def _sample(self, core: Any, before: Samples | None) -> Samples:
        settings = self.settings
        powers = settings.powers if before is None else settings.powers_again
        count = core.n_uniforms(len(powers), settings.n_local, settings.n_level)
        with self.clock.stage("sample"):
            samples, _, counters = core.run(
                self.rng.random((settings.n_chains, count)),
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
        self._count("passes", 1)
        self._count("sweeps", settings.n_chains * len(powers))
        for name, value in counters.items():
            self._count(name if name != "factorisations" else "small_factorisations", value)
        return tuple(samples)

    def _solve(
        self, linearised: Linearised, data: tuple[Posed, Any], samples: Samples, moment: Moment
    ) -> tuple[Moment, float]:
        """Return the equilibrium under the mean load, or as far towards it as the markers come closer.

        Beside it stands the residual that the linear model promises there.
        """
        problem, core = data
        wanted = core.moments(list(samples), np.zeros((0, self.columns.n_columns)), threads=self.threads)[0]
        promised = _promised(problem, wanted, samples)
        share, decrease = 1.0, _DECREASE_UNMATCHED if self.seen.rematches else _DECREASE
        # Points are matched anew, but weighed as they were for this step: it promises no more than that.
        std = self.seen.read(moment).std if self.seen.rough else None
        before = self.residual_rms(moment, samples, std)
        best: tuple[float, Moment] | None = None
        while share > (_SHORTEST_UNMATCHED if self.seen.rematches and best is not None else _SHORTEST_STEP):
            found = self._towards(linearised, moment, moment.coefficients + share * (wanted - moment.coefficients))
            if found is not None:
                left = self.residual_rms(found, samples, std)
                if best is None or left < best[0]:
                    best = (left, found)
                enough = 0.0 if self.seen.rematches else _GOOD_ENOUGH * self.settings.fit_limit
                if left < max((1.0 - decrease * share) * before, enough):
                    return found, promised
            share *= 0.5
            self._count("halved_steps", 1)
        if best is None:
            message = "no load between the last and the one that the markers suggest finds an equilibrium"
            raise ConvergenceError(message, where="load")
        return (best[1] if best[0] < before or not self.seen.rematches else moment), promised

    def _towards(self, linearised: Linearised, moment: Moment, coefficients: FloatArray) -> Moment | None:
        """Return the equilibrium under coefficients; None where there is none."""
        try:
            load = self.columns.load(coefficients)
            found = linearised.solve_near(
                load, springs=self.columns.springs, tolerance=_TOLERANCE, max_iterations=_MOST_ITERATIONS
            )
        except ConvergenceError:
            return None
        self._count("solves", 1)
        self._count("iterations", int(found.report["iterations"]))
        turned = self.columns.frame(coefficients)
        if not self.columns.body.supports.moves:
            # A drift is small and keeps its prior: its coefficients count from no motion.
            return Moment(coefficients, found.all_displacement, Frame.still().followed_by(turned, self.columns.rigid))
        frame = moment.frame.followed_by(turned, self.columns.rigid)
        return Moment(self.columns.without_frame(coefficients), found.all_displacement, frame)

    def residual_rms(self, moment: Moment, samples: Samples, std: FloatArray | None = None) -> float:
        """Return the root mean square residual of what is not wrong, over given standard deviations or its own."""
        reading = self.seen.read(moment)
        if std is not None:
            return float(np.sqrt(np.mean((reading.left / std) ** 2)))
        weights = np.ones(len(reading.cost))
        for group, wrong in zip(reading.groups, samples[2].mean(axis=0), strict=True):
            weights[group] = max(1.0 - wrong, 1e-6)
        return float(np.sqrt(np.average(reading.cost, weights=weights)))

    def _ended(self, history: list[float], promised: float) -> bool:
        """Return whether the data are met as well as the linear model promised, or the last passes brought nothing."""
        if len(history) < 2:
            return False
        if self.seen.rematches:
            few = len(history) < _LEAST_ROUGH and self.seen.rough and history[-1] > self.settings.fit_limit
            return not few and history[-1] > (1.0 - _SETTLED) * history[-2]
        met = history[-1] < self.settings.fit_limit and history[-1] < promised + self.settings.promise_margin
        return met or (len(history) > 3 and min(history[-2:]) > 0.95 * min(history[:-2]))

    def _fit(
        self,
        moment: Moment,
        linearised: Linearised,
        data: tuple[Posed, Any],
        samples: Samples,
        history: list[float],
    ) -> ContactFit:
        problem, core = data
        return ContactFit(
            self.columns,
            moment,
            linearised,
            problem,
            core,
            samples,
            self._wrong(moment, samples),
            float(core.moments(list(samples), np.zeros((0, self.columns.n_columns)), threads=self.threads)[5]),
            history,
            dict(self.counters),
        )

    def _wrong(self, moment: Moment, samples: Samples) -> FloatArray:
        """Return the probability that each marker is wrong, (n_markers,); zero where it was not seen."""
        markers = self.seen.markers
        if markers is None:
            return np.zeros(0)
        wrong = np.zeros(len(markers.markers))
        found = samples[2].mean(axis=0)
        if self.seen.weighed:
            spread = self.settings.wrong_share * self.columns.body.mesh.extent
            found = markers.wrong(moment, float(np.log(self.settings.wrong_odds)), spread)
        wrong[np.unique(markers.rows // 3)] = found
        return wrong

    def _count(self, name: str, value: int) -> None:
        self.counters[name] = self.counters.get(name, 0) + value


def _promised(problem: Posed, coefficients: FloatArray, samples: Samples) -> float:
    """Return the root mean square residual that the linear model promises, over standard deviations."""
    left = (problem.innovation - problem.responses @ coefficients) ** 2 / problem.variances
    weights = np.ones(len(left))
    for group, wrong in zip(problem.groups, samples[2].mean(axis=0), strict=True):
        weights[group] = max(1.0 - wrong, 1e-6)
    return float(np.sqrt(np.average(left, weights=weights)))


def start_of(columns: Columns, material: Material, simulation: FloatArray | None, frame: Frame, threads: int) -> Moment:
    """Return the body under the believed load.

    Parameters
    ----------
    columns : Columns
        Causes.
    material : Material
        What the body is made of.
    simulation : ndarray of float64, shape (n_element_nodes, 3), or None
        The displacement that the believed load holds, where it is known.
    frame : Frame
        Rigid motion to begin with.
    threads : int
        Threads to use.

    Returns
    -------
    Moment
        Zero coefficients.

    Raises
    ------
    ConvergenceError
        If the believed load finds no equilibrium.
    """
    zero = np.zeros(columns.n_columns)
    simulator = columns.body.simulator
    if simulation is not None:
        return Moment(zero, simulation, frame)
    if all(part is None for part in columns.believed.values()):
        return Moment(zero, np.zeros((simulator.body.n_nodes, 3)), frame)
    load: Load = columns.load(zero)
    found = simulator.solve(load, material, springs=columns.springs, tolerance=_TOLERANCE, threads=threads)
    return Moment(zero, found.all_displacement, frame)
