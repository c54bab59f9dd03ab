"""One frame (one measurement in time): as it was measured and waits, and as it is tracked, after the filter in time."""

import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.shown import notebook, short_repr
from tissuereg.body.mesh import det_f
from tissuereg.registration.inputs import Attachment, rms_length
from tissuereg.registration.result import Registration
from tissuereg.registration.target import Target


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """The measurement of one moment (a frame) before it is registered.

    `measured_mm` (n_markers, 3): places of the markers, mm; `time_s`: time of the measurement, s; `actuator`: state of
    the actuators, as the simulation takes it; `since`: clock reading from which the frame has waited, s.
    """

    measured_mm: Any
    time_s: Any
    actuator: Any
    since: float


class Inbox:
    """Buffer of one frame between camera and tracker: a newer frame replaces one that waits; `dropped` counts these."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frame: MeasuredFrame | None = None
        self._skipped = 0
        self.dropped = 0

    def push(self, frame: MeasuredFrame) -> None:
        """Store a frame; one that still waits to be registered is dropped and counted."""
        with self._lock:
            if self._frame is not None:
                self.dropped += 1
                self._skipped += 1
            self._frame = frame

    def take(self) -> tuple[MeasuredFrame, int] | None:
        """Take out the waiting frame, and the number of frames dropped since the last one; None if none waits."""
        with self._lock:
            if self._frame is None:
                return None
            taken = self._frame, self._skipped
            self._frame, self._skipped = None, 0
            return taken


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame (the measurement of one moment) after it was registered and filtered in time.

    Attributes
    ----------
    time_s : float
        Time of its measurement, s.
    registration : Registration
        The result after the filter that combines it with earlier frames.
    alone : Registration
        The result of this frame's own measurement alone.
    simulation : ndarray of float64, shape (n_nodes, 3), or None
        Simulated displacement from which it was registered, mm; None without a simulation.
    gain : float
        Weight of this frame's own result in the filtered one, 0 to 1; 1 = no other frame counts.
    widening : float
        Factor on the frame's own covariances, at least 1: it adds the errors of the earlier registered states from
        which the simulation was started.
    skipped : int
        Number of frames that were dropped just before this one, because a newer one was there.
    latency_s : float
        Time in s from when the frame was handed over, in a replay from when it was measured, to its result.
    """

    time_s: float
    registration: Registration
    alone: Registration
    simulation: FloatArray | None
    gain: float
    widening: float = 1.0
    skipped: int = 0
    latency_s: float = 0.0

    __repr__ = short_repr

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("frame", self)


@dataclass(frozen=True)
class Layout:
    """Positions of the parts of a registration in the flat array that the filter in time takes.

    The displacements of the markers, whose innovations tell the rate of motion, come first, then those of the targets,
    then those of the nodes, three components each. `attached`: markers and targets located in the mesh.
    """

    attached: Attachment  # markers and targets on the body

    @property
    def markers(self) -> slice:
        """Slice of the markers' components in the flat array of all values."""
        return slice(0, 3 * len(self.attached.places))

    @property
    def _targets(self) -> slice:
        return slice(self.markers.stop, self.markers.stop + 3 * len(self.attached.targets.names))

    def values(self, result: Registration) -> FloatArray:
        """Return the registered displacements of markers, targets and nodes as one flat array (n_values,), mm."""
        field = result.displacement
        targets = [result.targets[name].mean - result.targets[name].reference for name in self.attached.targets.names]
        return np.concatenate([self._of_markers(field).ravel(), np.ravel(targets), field.ravel()])

    def on_body(self, result: Registration) -> tuple[FloatArray, FloatArray]:
        """Return the registered places of all markers (n_markers, 3), and the spread of those not used (n_markers,).

        Both in mm; of the markers that were used the spread is zero.
        """
        names = result.all_markers.names
        spread = [np.sqrt(np.trace(result.unseen[name].covariance)) if name in result.unseen else 0.0 for name in names]
        return result.all_markers.reference + self._of_markers(result.displacement), np.array(spread)

    def change(self, field: FloatArray) -> FloatArray:
        """Return a field (n_nodes, 3), mm, as the displacement of markers, targets and nodes, flat (n_values,), mm."""
        inner = self.attached.targets
        return np.concatenate(
            [self._of_markers(field).ravel(), inner.predict(field[inner.nodes]).ravel(), field.ravel()]
        )

    def variance(self, result: Registration) -> float:
        """Return the mean posterior variance of a coordinate of the targets, mm^2; 1 without targets."""
        stated = [np.trace(one.covariance) / 3.0 for one in result.targets.values()]
        return float(np.mean(stated)) if stated else 1.0

    def filtered(self, result: Registration, values: FloatArray, alone: FloatArray) -> Registration:
        """Return the registration `result` of a frame with its places moved by `values` - `alone`.

        `values`, `alone` (n_values,): displacements of markers, targets and nodes after the filter and before, mm.
        Displacement, targets, unseen markers, residuals and volume ratios are those of the filtered places. Covariances
        stay those of the frame: errors of consecutive frames are correlated, and the share of them that the filter
        removes is not larger than what the frame states.
        """
        moved = values - alone
        of_markers = moved[self.markers].reshape(-1, 3)
        of_targets = moved[self._targets].reshape(-1, 3)
        field = values[self._targets.stop :].reshape(-1, 3)
        names = result.all_markers.names
        shift = dict(zip(names, of_markers, strict=True))
        residual = {name: row - shift[name] for name, row in result.markers.residual_mm.items()}
        ratios = det_f(result.mesh, field)
        after = rms_length(np.array(list(residual.values())).reshape(-1, 3))
        fit = replace(result.markers, after_rms_mm=after, residual_mm=residual)
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
        """Return a registration with the covariances of nodes, targets and unseen markers times `factor`."""
        if factor == 1.0:
            return result
        deviations = result.deviations
        return replace(
            result,
            deviations=lambda: deviations().times(factor),
            targets={name: _wider(one, factor) for name, one in result.targets.items()},
            unseen={name: _wider(one, factor) for name, one in result.unseen.items()},
        )

    def _of_markers(self, field: FloatArray) -> FloatArray:
        observed = self.attached.observed
        return observed.predict(field[observed.nodes])


def _wider(target: Target, factor: float) -> Target:
    return replace(target, covariance=factor * target.covariance)
