"""From markers to contacts: linearise, sample, solve, until the body meets the markers.

A pass takes the sensitivities of all markers at the present equilibrium, samples which contacts explain what is left,
and solves the equilibrium under the mean load. What the model gets wrong enters the samples through the noise of the
markers alone: as unknowns of its own it would explain away motion that the equilibrium then lacks.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray, IntArray
from tissuereg._clock import Clock
from tissuereg.contacts.columns import Columns, sampler
from tissuereg.contacts.frame import Frame
from tissuereg.contacts.settings import ContactSettings
from tissuereg.errors import ConvergenceError
from tissuereg.load import Load
from tissuereg.markers import Markers
from tissuereg.material import Material
from tissuereg.observe import MarkerObservation
from tissuereg.simulate.sensitivity import Linearised, Observation

#: Residual of an equilibrium that is linearised, over its load.
_TOLERANCE = 3e-7

#: Shortest share of a step towards the mean load.
_SHORTEST_STEP = 0.02

#: A step must take away this part of what it promises, or leave the markers within this many times the limit.
_DECREASE, _GOOD_ENOUGH = 0.3, 1.5

Samples = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen of the markers.

    Attributes
    ----------
    observation : MarkerObservation
        How markers follow the mesh.
    markers : Markers
        As given.
    mask : ndarray of bool, shape (n_markers, 3)
        Components that were seen.
    """

    observation: MarkerObservation
    markers: Markers

    @property
    def mask(self) -> BoolArray:
        """Components that were seen, shape (n_markers, 3)."""
        return np.asarray(np.isfinite(self.markers.measured))

    @property
    def rows(self) -> IntArray:
        """Indices of the components seen among all, shape (n_obs,)."""
        return np.flatnonzero(self.mask.ravel())

    @property
    def groups(self) -> list[list[int]]:
        """Places among `rows` of each marker that was seen."""
        owner = self.rows // 3
        return [np.flatnonzero(owner == marker).tolist() for marker in np.unique(owner)]

    def moved(self, frame: Frame) -> FloatArray:
        """Return how far each marker moved beside a rigid motion, (n_markers,) in mm; unseen components stay."""
        places = frame.apply(self.markers.reference)
        return np.asarray(np.linalg.norm(np.where(self.mask, self.markers.measured - places, 0.0), axis=1))

    def std(self, model_error: float, frame: Frame) -> FloatArray:
        """Return the standard deviation of each component seen: the tracker's and the model's, mm."""
        size = model_error * self.moved(frame)
        both = np.hypot(self.markers.axis_std, size[:, None])
        return both.ravel()[self.rows]


@dataclass(eq=False)
class Moment:
    """A deformed body on the way: coefficients, equilibrium, frame."""

    coefficients: FloatArray
    displacement: FloatArray
    frame: Frame


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
    sampler : _core.Contacts
        Dictionary, prior and data of the last pass.
    samples : tuple of ndarray
        Slots, levels and wrong groups of every sample.
    responses : ndarray of float64, shape (3 n_markers, n_columns)
        How all components of all markers follow the columns, in the tracker's frame.
    wrong : ndarray of float64, shape (n_markers,)
        Probability that a marker is wrong; zero where it was not seen.
    prior_misfit : float
        Mean over samples of the prior term of the misfit, that of the coefficients.
    residual_rms : list of float
        Root mean square distance of the markers after each pass, mm.
    counters : dict of str to int
        Work.
    """

    columns: Columns
    moment: Moment
    linearised: Linearised
    sampler: Any
    samples: Samples
    responses: FloatArray
    wrong: FloatArray
    prior_misfit: float
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
        moment = start
        samples: Samples | None = None
        history: list[float] = []
        promised = 0.0
        reached: list[tuple[Moment, Samples]] = []
        for index in range(self.settings.max_passes + 1):
            last = index == self.settings.max_passes or self._ended(history, promised)
            if last and reached:
                # Past a limit point of the load passes may lead away again: the closest one counts.
                moment, samples = reached[int(np.argmin(history))]
            linearised = self._linearise(moment)
            responses = self._responses(linearised, moment)
            core = self._sampler(responses, moment)
            if last and samples is not None:
                return self._fit(moment, linearised, core, samples, responses, history)
            samples = self._sample(core, samples)
            with self.clock.stage("solve"):
                moment, promised = self._solve(linearised, core, samples, moment, responses)
            history.append(self.residual_rms(moment, samples))
            reached.append((moment, samples))
            if self.progress is not None:
                self.progress(index + 1, self.settings.max_passes)
        message = "at least one pass must be allowed"
        raise ConvergenceError(message, where="max_passes")

    def linear(self, moment: Moment) -> tuple[FloatArray, FloatArray]:
        """Return what is left of the markers (n_obs,), mm, and how they follow the columns (n_obs, n_columns)."""
        responses = self._responses(self._linearise(moment), moment)
        return self._left(moment), responses[self.seen.rows]

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

    def _responses(self, linearised: Linearised, moment: Moment) -> FloatArray:
        observation = self.seen.observation
        with self.clock.stage("sensitivities"):
            rows = observation.rows(moment.displacement[observation.nodes])
            compliance = linearised.compliance([Observation(nodes, weights) for nodes, weights in rows])
            self._count("right_hand_sides", len(rows))
            found = self.columns.responses(compliance, self.seen.markers.reference + self._predicted(moment))
            return moment.frame.turn(found)

    def _predicted(self, moment: Moment) -> FloatArray:
        """Return displacements (n_markers, 3) of all markers in the body's frame, mm."""
        observation = self.seen.observation
        return observation.predict(moment.displacement[observation.nodes])

    def _left(self, moment: Moment) -> FloatArray:
        """Return measured minus predicted of the components seen, in the tracker's frame, shape (n_obs,), mm."""
        measured, reference = self.seen.markers.measured, self.seen.markers.reference
        places = moment.frame.apply(reference + self._predicted(moment))
        return np.asarray((measured - places).ravel()[self.seen.rows])

    def _sampler(self, responses: FloatArray, moment: Moment) -> Any:
        rows = self.seen.rows
        left = self._left(moment)
        own = responses[rows]
        std = self.seen.std(self.settings.model_error, moment.frame)
        data = {
            "innovation": left + own @ moment.coefficients,
            "noise": np.diag(std**2),
            "groups": self.seen.groups,
        }
        with self.clock.stage("prepare"):
            return sampler(self.columns, self.settings, own, data)

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
        self, linearised: Linearised, core: Any, samples: Samples, moment: Moment, responses: FloatArray
    ) -> tuple[Moment, float]:
        """Return the equilibrium under the mean load, or as far towards it as the markers come closer.

        Beside it stands the residual that the linear model promises there.
        """
        wanted = core.moments(list(samples), np.zeros((0, self.columns.n_columns)), threads=self.threads)[0]
        left, frame = self._left(moment), moment.frame
        promised = self._rms(left - responses[self.seen.rows] @ (wanted - moment.coefficients), samples, frame)
        before, share = self._rms(left, samples, frame), 1.0
        best: tuple[float, Moment] | None = None
        while share > _SHORTEST_STEP:
            found = self._towards(linearised, moment, moment.coefficients + share * (wanted - moment.coefficients))
            if found is not None:
                rms = self.residual_rms(found, samples)
                if best is None or rms < best[0]:
                    best = (rms, found)
                if rms < max((1.0 - _DECREASE * share) * before, _GOOD_ENOUGH * self.settings.fit_limit):
                    return found, promised
            share *= 0.5
            self._count("halved_steps", 1)
        if best is None:
            message = "no load between the last and the one that the markers suggest finds an equilibrium"
            raise ConvergenceError(message, where="load")
        return best[1], promised

    def _towards(self, linearised: Linearised, moment: Moment, coefficients: FloatArray) -> Moment | None:
        """Return the equilibrium under coefficients; None where there is none."""
        try:
            found = linearised.solve_near(
                self.columns.load(coefficients), springs=self.columns.springs, tolerance=_TOLERANCE
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

    def residual_rms(self, moment: Moment, samples: Samples) -> float:
        """Return the root mean square residual of markers that are not wrong, over their standard deviation."""
        return self._rms(self._left(moment), samples, moment.frame)

    def _rms(self, left: FloatArray, samples: Samples, frame: Frame) -> float:
        scaled = (left / self.seen.std(self.settings.model_error, frame)) ** 2
        right = 1.0 - samples[2].mean(axis=0)
        weights = np.concatenate([np.full(len(g), w) for g, w in zip(self.seen.groups, right, strict=True)])
        order = np.concatenate([np.asarray(g) for g in self.seen.groups])
        return float(np.sqrt(np.average(scaled[order], weights=np.maximum(weights, 1e-6))))

    def _ended(self, history: list[float], promised: float) -> bool:
        """Return whether the markers are met as well as the linear model promised, or two passes brought nothing."""
        if len(history) < 2:
            return False
        met = history[-1] < self.settings.fit_limit and history[-1] < promised + self.settings.promise_margin
        return met or (len(history) > 3 and min(history[-2:]) > 0.95 * min(history[:-2]))

    def _fit(
        self,
        moment: Moment,
        linearised: Linearised,
        core: Any,
        samples: Samples,
        responses: FloatArray,
        history: list[float],
    ) -> ContactFit:
        wrong = np.zeros(len(self.seen.markers))
        wrong[np.unique(self.seen.rows // 3)] = samples[2].mean(axis=0)
        return ContactFit(
            self.columns,
            moment,
            linearised,
            core,
            samples,
            responses,
            wrong,
            self._prior_misfit(moment, responses, wrong),
            history,
            dict(self.counters),
        )

    def _prior_misfit(self, moment: Moment, responses: FloatArray, wrong: FloatArray) -> float:
        """Return the prior term of the misfit, ``c' D^-1 c = (J c)' C_d^-1 r``, since ``c = D J' C_d^-1 r``."""
        rows = self.seen.rows
        left = self._left(moment)
        moved = responses[rows] @ moment.coefficients
        weights = (wrong[rows // 3] < 0.5) / self.seen.std(self.settings.model_error, moment.frame) ** 2
        return float(max(0.0, np.sum(weights * moved * left)))

    def _count(self, name: str, value: int) -> None:
        self.counters[name] = self.counters.get(name, 0) + value


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
