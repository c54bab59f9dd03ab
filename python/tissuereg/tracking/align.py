"""Rigid alignment of a tracker's frame to the body's, from points known in both, before anything is tracked."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tissuereg._base.arguments import real, texts
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.errors import MarkerError
from tissuereg.registration.contacts.state import RigidMotion


class AlignSettings(NamedTuple):
    """When points align two frames.

    `fewest`: points that a rigid motion needs; `thin`: smallest extent of the points across the line through them, as a
    share of that along it; `share`: largest rms residual, as a share of the points' rms distance from their middle,
    or as `noise` standard deviations of their coordinates, whichever is larger.
    """

    fewest: int = 3
    thin: float = 0.05
    share: float = 0.05
    noise: float = 4.0


ALIGN = AlignSettings()


def another_frame(measured: FloatArray, reference: FloatArray, extent: float) -> str:
    """Return why places cannot be those of markers on a body of this extent, mm, in its frame; empty if they can.

    `measured` (n_frames, n_markers, 3), `reference` (n_markers, 3): mm; NaN where not seen. The first frame in which a
    marker is seen tells: no body moves by its own extent until then.
    """
    every = np.asarray(np.isfinite(measured).all(axis=2))
    if not every.any():
        return ""
    first = int(np.argmax(np.asarray(every.any(axis=1))))
    seen, places = every[first], measured[first]
    off = float(np.median(np.linalg.norm(places[seen] - reference[seen], axis=1)))
    if off <= extent:
        return ""
    fits = ""
    if seen.sum() >= ALIGN.fewest:
        moved = RigidMotion.between(places[seen], reference[seen]).apply(places[seen])
        left = float(np.sqrt(np.mean(np.sum((moved - reference[seen]) ** 2, axis=1))))
        fits = f" (a rigid motion brings them to {left:.3g} mm)"
    return (
        f"the markers' first places lie {off:.4g} mm from the reference, farther than the body is long, {extent:.4g} mm"
        f"{fits}: the tracker has a frame or a unit of its own"
    )


@dataclass(frozen=True, eq=False)
class Alignment:
    """The rigid motion from the tracker's frame to the body's, and how well the points fit it.

    Attributes
    ----------
    rotation : ndarray of float64, shape (3, 3)
        Rotation R of ``x -> R x + s``.
    shift : ndarray of float64, shape (3,)
        Translation s, mm.
    residual_mm : dict of str to float
        Distance of each point from where the motion takes it, mm.
    rms_mm : float
        Root mean square of these, mm. It says little of points far from these, and nothing of a turn that they fit too.
    """

    rotation: FloatArray
    shift: FloatArray
    residual_mm: dict[str, float]
    rms_mm: float

    def apply(self, places: Any) -> FloatArray:
        """Return places (..., 3), mm, in the body's frame, given them in the tracker's."""
        return RigidMotion(self.rotation, self.shift).apply(np.asarray(places, dtype=np.float64))

    def to_json(self) -> dict[str, Any]:
        """Return the motion and its residuals as plain data."""
        return {
            "rotation": self.rotation.tolist(),
            "shift_mm": self.shift.tolist(),
            "rms_mm": self.rms_mm,
            "residual_mm": self.residual_mm,
        }


def rigid_alignment(tracker_mm: Any, body_mm: Any, names: Any = None, *, std: float = 0.1) -> Alignment:
    """Return the rigid motion that takes points in the tracker's frame to the same points in the body's frame.

    Parameters
    ----------
    tracker_mm, body_mm : array_like of float, shape (n_points, 3)
        The same three or more points, not on one line, in both frames, mm; those with NaN in either are left out.
    names : sequence of str, optional
        Name of each point; ``1``, ``2`` and so on by default.
    std : float
        Standard deviation of a coordinate of these points, mm.

    Returns
    -------
    Alignment
        The motion, best by least squares, and its residuals.

    Raises
    ------
    MarkerError
        If fewer than three points are known in both, they lie on one line, or they do not fit one rigid motion: points
        exchanged, mirrored or in another unit.
    ShapeError, ArgumentError
        If an argument has the wrong shape or type.

    Examples
    --------
    >>> body = [[0.0, 0, 0], [40, 0, 0], [0, 30, 0]]
    >>> turned = [[5.0, 0, 0], [5, 40, 0], [-25, 0, 0]]
    >>> found = rigid_alignment(turned, body)
    >>> found.rms_mm < 1e-9, found.apply([5.0, 20, 0]).round(6)[0].item()
    (True, 20.0)
    """
    tracker = float_array("tracker_mm", tracker_mm, (None, 3))
    body = float_array("body_mm", body_mm, (len(tracker), 3))
    titles = [str(i + 1) for i in range(len(tracker))] if names is None else texts("names", names, length=len(tracker))
    noise = real("std", std, above=0.0, unit="mm")
    known = np.flatnonzero(np.isfinite(tracker).all(axis=1) & np.isfinite(body).all(axis=1))
    if len(known) < ALIGN.fewest:
        message = f"{ALIGN.fewest} or more points must be known in both frames to align them, got {len(known)}"
        raise MarkerError(message, where="tracker_mm")
    tracker, body, titles = tracker[known], body[known], [titles[i] for i in known]
    sizes = np.linalg.svd(body - body.mean(axis=0), compute_uv=False)
    if sizes[1] <= ALIGN.thin * sizes[0]:
        message = "points that align two frames must not lie on one line: turns about it would not be known"
        raise MarkerError(message, where="body_mm")
    motion = RigidMotion.between(tracker, body)
    off = np.linalg.norm(motion.apply(tracker) - body, axis=1)
    rms, extent = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.sum(sizes**2) / len(body)))
    limit = max(ALIGN.noise * noise, ALIGN.share * extent)
    if rms > limit:
        worst = titles[int(np.argmax(off))]
        message = (
            f"points must fit one rigid motion to align two frames: their rms residual is {rms:.3g} mm, more than "
            f"{limit:.3g} mm; the farthest is '{worst}' with {off.max():.3g} mm.{_why(tracker, body, limit)}"
        )
        raise MarkerError(message, where="tracker_mm")
    return Alignment(motion.rotation, motion.shift, dict(zip(titles, off.tolist(), strict=True)), rms)


def _why(tracker: FloatArray, body: FloatArray, limit: float) -> str:
    """Return a sentence on what would make the points fit: a mirror, another unit, or one point less."""
    mirrored = tracker * (-1.0, 1.0, 1.0)
    if _rms(mirrored, body) <= limit:
        return " Mirrored they fit: one of the frames is left-handed"
    scale = float(np.std(body - body.mean(axis=0))) / max(float(np.std(tracker - tracker.mean(axis=0))), 1e-300)
    if _rms(scale * tracker, body) <= limit:
        return f" Times {scale:.3g} they fit: are both in mm?"
    return " Are points exchanged, or was the body deformed already?"


def _rms(tracker: FloatArray, body: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum((RigidMotion.between(tracker, body).apply(tracker) - body) ** 2, axis=1))))
