"""One frame: as it was measured and waits, and as it is tracked, after the temporal prior."""

import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import det_f
from tissuereg.registration.inputs import Attachment, rms_length
from tissuereg.registration.result import MarkerFit, Registration, Target


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A frame before it is registered.

    `measured_mm` (n_markers, 3): places of the markers; `time_s`: time of the measurement; `actuator`: what the
    actuators did, in the simulation's own terms; `since`: clock reading from which it has waited, s.
    """

    measured_mm: Any
    time_s: Any
    actuator: Any
    since: float


class Inbox:
    """A place for one frame between a camera and a tracker: a newer frame takes the place of one that waits."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frame: MeasuredFrame | None = None
        self._skipped = 0
        self.dropped = 0

    def push(self, frame: MeasuredFrame) -> None:
        """Put a frame in; a frame that is still waiting to be registered is dropped and counted."""
        with self._lock:
            if self._frame is not None:
                self.dropped += 1
                self._skipped += 1
            self._frame = frame

    def take(self) -> tuple[MeasuredFrame, int] | None:
        """Return the frame that waits, and how many were dropped since the last one; None if none waits."""
        with self._lock:
            if self._frame is None:
                return None
            taken = self._frame, self._skipped
            self._frame, self._skipped = None, 0
            return taken


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A tracked frame.

    Attributes
    ----------
    time_s : float
        When it was measured.
    registration : Registration
        The answer, after the temporal prior.
    alone : Registration
        The answer of this frame's own measurement.
    simulation : ndarray of float64, shape (n_nodes, 3), or None
        Displacement from which it was registered, mm.
    gain : float
        Share of this frame's own answer, 0 to 1; 1 = no other frame counts.
    widening : float
        Factor on the frame's own covariances: the errors of the registered states that were carried on.
    skipped : int
        Frames that were dropped just before this one, because a newer one was there.
    latency_s : float
        From when it was handed over, in a replay from when it was measured, to its answer.
    """

    time_s: float
    registration: Registration
    alone: Registration
    simulation: FloatArray | None
    gain: float
    widening: float = 1.0
    skipped: int = 0
    latency_s: float = 0.0


@dataclass(frozen=True)
class Layout:
    """Where the parts of a registration lie in the array that the temporal prior filters.

    First the markers, whose innovations tell the rate of motion, then the targets, then the nodes; three components
    each.
    """

    attached: Attachment  # markers and targets on the body

    @property
    def markers(self) -> slice:
        """The markers' components."""
        return slice(0, 3 * len(self.attached.places))

    @property
    def _targets(self) -> slice:
        return slice(self.markers.stop, self.markers.stop + 3 * len(self.attached.targets.names))

    def values(self, result: Registration) -> FloatArray:
        """Return the registered displacement of markers, targets and nodes, (n_values,), mm."""
        field = result.displacement
        targets = [result.targets[name].mean - result.targets[name].reference for name in self.attached.targets.names]
        return np.concatenate([self._of_markers(field).ravel(), np.ravel(targets), field.ravel()])

    def change(self, field: FloatArray) -> FloatArray:
        """Return a displacement (n_nodes, 3), mm, in the filter's layout: of markers, targets, nodes; flat."""
        inner = self.attached.targets
        return np.concatenate(
            [self._of_markers(field).ravel(), inner.predict(field[inner.nodes]).ravel(), field.ravel()]
        )

    def variance(self, result: Registration) -> float:
        """Return the mean variance of a target's coordinate that a registration states, mm^2; 1 without targets."""
        stated = [np.trace(one.covariance) / 3.0 for one in result.targets.values()]
        return float(np.mean(stated)) if stated else 1.0

    def filtered(self, result: Registration, values: FloatArray, alone: FloatArray) -> Registration:
        """Return the registration of a frame alone with its places moved by `values` - `alone`, (n_values,) each, mm.

        Displacement, targets, unseen markers, residuals and volume ratios are those of the filtered places. Covariances
        stay those of the frame: errors of consecutive frames are correlated, and what the filter removes of them is not
        more than the frame states.
        """
        moved = values - alone
        of_markers = moved[self.markers].reshape(-1, 3)
        of_targets = moved[self._targets].reshape(-1, 3)
        field = values[self._targets.stop :].reshape(-1, 3)
        names = result.all_markers.names
        shift = dict(zip(names, of_markers, strict=True))
        residual = {name: row - shift[name] for name, row in result.markers.residual_mm.items()}
        ratios = det_f(result.mesh, field)
        fit = MarkerFit(
            result.markers.used,
            result.markers.dropped,
            result.markers.before_rms_mm,
            rms_length(np.array(list(residual.values())).reshape(-1, 3)),
            residual,
        )
        targets = zip(self.attached.targets.names, of_targets, strict=True)
        return replace(
            result,
            displacement=field,
            targets={name: replace(result.targets[name], mean=result.targets[name].mean + by) for name, by in targets},
            unseen={name: replace(one, mean=one.mean + shift[name]) for name, one in result.unseen.items()},
            markers=fit,
            min_det_f=float(ratios.min()),
            inverted_tets=int((ratios <= 0).sum()),
        )

    @staticmethod
    def widened(result: Registration, factor: float) -> Registration:
        """Return a registration with all covariances times a factor."""
        if factor == 1.0:
            return result
        nodes = result.nodes

        def wider() -> FloatArray:
            found = nodes()
            return np.asarray(found * (factor if found.ndim == 3 else np.sqrt(factor)))

        return replace(
            result,
            nodes=wider,
            targets={name: _wider(one, factor) for name, one in result.targets.items()},
            unseen={name: _wider(one, factor) for name, one in result.unseen.items()},
        )

    def _of_markers(self, field: FloatArray) -> FloatArray:
        observed = self.attached.observed
        return observed.predict(field[observed.nodes])


def _wider(target: Target, factor: float) -> Target:
    return replace(target, covariance=factor * target.covariance)
