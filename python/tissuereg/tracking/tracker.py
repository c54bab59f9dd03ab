"""The class `Tracker`: frame after frame, the registered state restarts the simulation (loop of the paper's Fig. 1)."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from tissuereg._base.arguments import called, check_choice, each, flag, found, real
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.choices import RESTARTS, RestartKind
from tissuereg._base.shown import notebook
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, ConvergenceError, EnsembleError, MarkerError, TissueRegError
from tissuereg.registration.body import Body
from tissuereg.registration.inputs import SimulationVariants, finite_field
from tissuereg.registration.registrar import Registrar
from tissuereg.registration.result import Registration
from tissuereg.tracking.frame import Inbox, Layout, MeasuredFrame, TrackedFrame
from tissuereg.tracking.physics import Physics, as_physics
from tissuereg.tracking.restart import Lineage, Restart, SimulatedFrame
from tissuereg.tracking.temporal import TemporalPrior
from tissuereg.tracking.watch import Watch

#: Errors of one frame that leave the tracker as it was: no marker was seen, or no equilibrium or ensemble was found.
CANNOT_BE_REGISTERED = (MarkerError, ConvergenceError, EnsembleError)

_A_FRAME = "(time_s, measured_mm) or (time_s, measured_mm, actuator)"


class Tracker:
    """Registers one body frame after frame (moment after moment), each from the registered state of the last one.

    A frame is simulated from the registered state of the last one and the known motion of the actuators, registered to
    its markers, and combined with the last frames, by a filter in time, as far as the body stood still between them.

    Parameters
    ----------
    body : Registrar, Mesh, Body or (nodes, tets, fixed_nodes)
        The registrar that registers each frame; or the undeformed body in mm, of which a registrar is made with default
        settings.
    reference_mm : array_like of float, shape (n_markers, 3), or Markers
        Places of the markers on the undeformed body, mm; required unless a registrar is given.
    model : path-like or LatentModel, optional
        A trained model or its folder, ``"phantom"`` or ``"phantom-graph"`` for shipped ones, or one of `fitted_prior`.
        Without it the load is unknown, and the search for contacts in a frame starts from those of the last one.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body by name, mm, whose deformed places are wanted.
    simulator : Physics or callable of actuator -> array_like of float, shape (n_nodes, 3), optional
        The simulation of the body for a state of the actuators, with displacements in mm. Without it each frame is
        registered from the body at rest.
    variants : sequence of Physics or callable, optional
        The same simulation with other values of uncertain parameters, each given the same actuators: four or more, with
        a model that was calibrated with pairs of simulation and truth. A frame is registered from their mean.
    restart : {"forces", "displacement", "guess", "reference"}
        How the registered state restarts the simulation: as the nodal loads that hold it, as a displacement that is
        added to the next simulation, as a first guess, or not at all; see `tissuereg.tracking.restart`. Without a model
        ``forces`` and ``displacement`` are ``guess``: the contacts of the last frame are the forces that hold its
        shape.
    temporal : bool
        Whether the result of a frame is combined with those of the frames before, by a filter in time.

    Raises
    ------
    MarkerError, ModelError, ShapeError, ArgumentError, MeshError
        If the input cannot be used, as for `Registrar`.

    Notes
    -----
    Cost of a frame: one simulation and one registration, and a few passes over arrays of the size of a field. What
    depends on body, model and places is made once, with the tracker.

    Examples
    --------
    >>> import tissuereg as tr
    >>> from tissuereg.phantom.event import LESION_MM, make_event
    >>> event = make_event(seed=0)
    >>> physics = tr.tracking.FemPhysics(event.mesh, event.material)
    >>> tracker = tr.Tracker(event.mesh, event.markers.reference, "phantom", {"lesion": LESION_MM}, simulator=physics)
    >>> for k in range(2):
    ...     result = tracker.step(event.markers.measured, 0.025 * k, actuator=event.load)
    >>> result.trust.ok, tracker.last.gain < 1.0
    (True, True)
    """

    def __init__(
        self,
        body: Registrar | Mesh | Body | tuple[Any, Any, Any],
        reference_mm: Any = None,
        model: Any = None,
        targets: Mapping[str, Any] | None = None,
        *,
        simulator: Any = None,
        variants: Any = (),
        restart: RestartKind = "guess",
        temporal: bool = True,
    ) -> None:
        check_choice("restart", restart, RESTARTS, ArgumentError)
        self._registrar = _registrar(body, reference_mm, model, targets)
        self._physics = physics = None if simulator is None else as_physics(simulator, "simulator")
        self._variants = [as_physics(one, "variants") for one in each("variants", variants, object)]
        self._noise_mm = float(np.sqrt(np.mean(self._registrar.markers.axis_std**2)))
        # Contacts are the forces that hold the last shape already.
        how = "guess" if self._registrar.by_contacts and restart != "reference" else restart
        self._restart = None if physics is None else Restart(physics, how, self._noise_mm)
        self._layout = Layout(self._registrar.attached)
        self._temporal = flag("temporal", temporal)
        self._inbox = Inbox()
        self.reset()

    def __repr__(self) -> str:
        when = "no frame yet" if self._last is None else f"last frame at {self._last.time_s:g} s"
        return f"Tracker({self._registrar!r}, {when}, {self.dropped} dropped)"

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("tracker", self)

    @property
    def registrar(self) -> Registrar:
        """The `Registrar` that registers each frame."""
        return self._registrar

    @property
    def simulator(self) -> Physics | None:
        """The simulation of each frame, from the actuators' state to a displacement in mm; None if there is none."""
        return self._physics

    @property
    def last(self) -> TrackedFrame | None:
        """The last frame, with its result before and after the filter in time; None before the first one."""
        return self._last

    @property
    def dropped(self) -> int:
        """Number of frames that were pushed and never registered, because a newer one was there."""
        return self._inbox.dropped

    @property
    def fallbacks(self) -> int:
        """Number of frames in which the body lost its equilibrium under the dead loads of the registered state."""
        return 0 if self._restart is None else self._restart.fallbacks

    def reset(self) -> None:
        """Forget all frames, so that the next one is a first one; the count of dropped frames stays."""
        self._registrar.begin_anew()
        self._prior = TemporalPrior(self._noise_mm**2)
        self._lineage = Lineage(self._noise_mm)
        self._watch = Watch(self._registrar.markers)
        self._last: TrackedFrame | None = None
        if self._restart is not None:
            self._restart.reset()
        self._most_used = 0

    def step(self, measured_mm: Any, time_s: float, *, actuator: Any = None) -> Registration:
        """Register the next frame, the markers measured at one moment.

        Parameters
        ----------
        measured_mm : array_like of float, shape (n_markers, 3), or Markers
            Measured places in mm; NaN = not seen.
        time_s : float
            Time of the measurement, s; later than that of the last frame.
        actuator : object
            State of the actuators, as the simulator takes it.

        Returns
        -------
        Registration
            The registered body after the filter in time; `last` holds the result of this frame alone and more.

        Raises
        ------
        ArgumentError
            If the frame is not later than the last one, or the simulator does not know the actuator's state.
        MarkerError, ShapeError, ConvergenceError, EnsembleError
            If the frame cannot be registered, as by `Registrar.register`. The tracker is then as before this frame.
        """
        frame = MeasuredFrame(measured_mm, time_s, actuator, time.perf_counter())
        return self._tracked(frame, 0, time.perf_counter).registration

    def update(self, time_s: float, measured_mm: Any, actuator: Any = None) -> Registration:
        """Register the next frame and return its result; the same as `step`, with the time in s first."""
        return self.step(measured_mm, time_s, actuator=actuator)

    def push(self, measured_mm: Any, time_s: float, *, actuator: Any = None) -> None:
        """Hand over a frame, to be registered by the next `poll`; a frame that still waits is dropped and counted.

        May be called from another thread than `poll`.

        Parameters
        ----------
        measured_mm, time_s, actuator
            Measured places (n_markers, 3) in mm, their time in s, and the state of the actuators, as in `step`. They
            are checked when the frame is registered.
        """
        self._inbox.push(MeasuredFrame(measured_mm, time_s, actuator, time.perf_counter()))

    def poll(self) -> TrackedFrame | None:
        """Register the newest frame that was pushed, and return it; None if no frame waits.

        Returns
        -------
        TrackedFrame or None
            The frame with its result, and the number of frames that were dropped since the last one.

        Raises
        ------
        ArgumentError, MarkerError, ShapeError, ConvergenceError, EnsembleError
            If the frame cannot be registered, as by `step`; the frame is then lost.
        """
        taken = self._inbox.take()
        return None if taken is None else self._tracked(*taken, time.perf_counter)

    def run(
        self,
        frames: Iterable[tuple[Any, ...]],
        *,
        failed: Callable[[float, TissueRegError], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[float], None] = time.sleep,
    ) -> Iterator[TrackedFrame]:
        """Replay a recording at the rate at which it was measured.

        No frame is registered before its time. If its time comes while another one is registered, it waits; if the time
        of the next one comes as well, it is dropped and counted: the tracker goes on with the newest.

        Parameters
        ----------
        frames : iterable of (time_s, measured_mm) or (time_s, measured_mm, actuator)
            The frames in the order of time: time in s, places of the markers (n_markers, 3) in mm, state of the
            actuators.
        failed : callable of (float, TissueRegError), optional
            Called with the time of a frame that cannot be registered and the reason; the replay goes on. Without it the
            error is raised.
        clock : callable
            Returns the time now, s.
        wait : callable of float
            Waits for the given number of seconds.

        Yields
        ------
        TrackedFrame
            Each frame that was registered, with its result.

        Raises
        ------
        ArgumentError, MarkerError, ShapeError, ConvergenceError, EnsembleError
            If a frame cannot be registered, as by `step`.
        """
        called("failed", failed)
        offset: float | None = None
        for time_s, measured_mm, actuator in _each(frames):
            offset = clock() - time_s if offset is None else offset
            due = offset + time_s
            if clock() < due:
                yield from self._answer(clock, failed)
                if (remaining := due - clock()) > 0.0:
                    wait(remaining)
            self._inbox.push(MeasuredFrame(measured_mm, time_s, actuator, due))
        yield from self._answer(clock, failed)

    def _answer(
        self, clock: Callable[[], float], failed: Callable[[float, TissueRegError], None] | None
    ) -> Iterator[TrackedFrame]:
        """Register the frame that waits and yield it, if there is one; pass an error to `failed`, if it is given."""
        taken = self._inbox.take()
        if taken is None:
            return
        try:
            tracked = self._tracked(*taken, clock)
        except CANNOT_BE_REGISTERED as error:
            if failed is None:
                raise
            failed(taken[0].time_s, error)
        else:
            yield tracked

    def _tracked(self, frame: MeasuredFrame, skipped: int, clock: Callable[[], float]) -> TrackedFrame:
        time_s, actuator = real("time_s", frame.time_s, unit="s"), frame.actuator
        elapsed = math.inf
        if self._last is not None:
            elapsed = time_s - self._last.time_s
            if elapsed <= 0.0:
                message = f"`time_s` must be later than the last frame's {self._last.time_s:g} s, got {time_s:g}"
                raise ArgumentError(message, where="time_s")
        simulated = self._simulated(actuator)
        field = None if simulated is None else finite_field(simulated.field, self._registrar.mesh)
        after = self._last.alone if self._last is not None and self._registrar.by_contacts else None
        measured, lost = self._measured(frame), dict[str, str]()
        if measured is not None:
            lost = self._watch.lost(measured, time_s)
        alone = self._registrar.register(frame.measured_mm, self._varied(actuator, field), after=after, lost=lost)
        if measured is not None:
            self._watch.registered(measured, time_s, lost, alone.all_markers, self._layout.on_body(alone))
        result, gain = self._combined(alone, simulated, elapsed)
        widening = self._lineage.widening(self._layout.variance(alone), simulated)
        result = self._layout.widened(result, widening)
        latency_s = clock() - frame.since
        self._last = TrackedFrame(time_s, result, alone, field, gain, widening, skipped, latency_s)
        if self._restart is not None and simulated is not None:
            moved_on = self._restart.registered(simulated, result.displacement, actuator)
            if moved_on and not self._lineage.goes_on(self._layout.variance(alone), simulated):
                self._restart.renew()
        return self._last

    def _measured(self, frame: MeasuredFrame) -> FloatArray | None:
        """Return the measured places (n_markers, 3) of a frame, mm; None if they are not those of these markers."""
        given = frame.measured_mm
        places = given.measured if isinstance(given, Markers) else float_array("measured_mm", given, (None, 3))
        return places if len(places) == len(self._registrar.markers) else None

    def _varied(self, actuator: Any, field: FloatArray | None) -> SimulationVariants | FloatArray | None:
        """Return a frame's simulated `field` (n_nodes, 3), mm, with those by variants of the simulator, if any."""
        shape = self._registrar.mesh.nodes.shape
        fields = [float_array("variants", one.field(actuator), shape) for one in self._variants]
        return SimulationVariants(fields, field) if fields else field

    def _simulated(self, actuator: Any) -> SimulatedFrame | None:
        if self._restart is None:
            if actuator is not None and not self._variants:
                message = "an `actuator` needs a `simulator` that knows it; the tracker has none"
                raise ArgumentError(message, where="actuator")
            return None
        return self._restart.simulated(actuator)

    def _combined(
        self, alone: Registration, simulated: SimulatedFrame | None, elapsed: float
    ) -> tuple[Registration, float]:
        """Return a frame's registration after the filter in time, and the weight of its own result in it, 0 to 1."""
        n_used = len(alone.markers.used)
        if not self._temporal or n_used == 0:
            return alone, 1.0
        self._most_used = max(self._most_used, n_used)
        values = self._layout.values(alone)
        change = np.zeros_like(values) if simulated is None else self._layout.change(simulated.change)
        filtered = self._prior.updated(values, change, elapsed, self._most_used / n_used, self._layout.markers)
        return self._layout.filtered(alone, filtered, values), self._prior.gain


def _each(frames: Any) -> Iterator[tuple[float, Any, Any]]:
    """Return an iterator over time (s), measured places (mm) and actuator state of each frame of a recording."""
    if not isinstance(frames, Iterable) or isinstance(frames, str | bytes):
        message = f"`frames` must be frames, each {_A_FRAME}, got {found(frames)}"
        raise ArgumentError(message, where="frames")
    for frame in frames:
        if not isinstance(frame, tuple | list) or len(frame) not in (2, 3):
            message = f"each of `frames` must be {_A_FRAME}, got {found(frame)}"
            raise ArgumentError(message, where="frames")
        time_s = real("time_s of `frames`", frame[0], unit="s")
        yield time_s, frame[1], frame[2] if len(frame) == 3 else None


def _registrar(body: Any, reference_mm: Any, model: Any, targets: Any) -> Registrar:
    if not isinstance(body, Registrar):
        if reference_mm is None:
            message = "`reference_mm` must be the places of the markers on the undeformed body, got None"
            raise MarkerError(message, where="reference_mm")
        return Registrar(body, reference_mm, model, targets)
    for name, value in {"reference_mm": reference_mm, "model": model, "targets": targets}.items():
        if value is not None:
            message = f"`{name}` must be left out: the registrar has it already"
            raise ArgumentError(message, where=name)
    return body
