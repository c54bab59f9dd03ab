"""Errors of the marker tracker: wrong frame, scale or time, markers that slip, markers mistaken for each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.fields import number, numbers, text, texts
from tissuereg.experiment.effects.base import ChainEffect, Vector, refuse, rotation_from_vector
from tissuereg.experiment.experiment import Experiment


@dataclass(frozen=True, kw_only=True)
class Frame(ChainEffect):
    """The tracker's frame is another one: seen = R place + shift, R about the origin.

    `rotation_deg`: rotation vector of R, axis times angle in degrees; `shift_mm`: shift vector, mm.
    """

    id: ClassVar[str] = "frame"
    rotation_deg: Vector = numbers("rotation vector of R, about the origin", 3, default=(0.0, 0.0, 0.0))
    shift_mm: Vector = numbers("shift", 3, default=(0.0, 0.0, 0.0))

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the reported places (n_frames, n_markers, 3), mm: the true ones, rotated and shifted."""
        return np.asarray(places @ rotation_from_vector(self.rotation_deg).T + np.asarray(self.shift_mm))

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true places (n_frames, n_markers, 3), mm, from reported ones: shifted and rotated back."""
        return np.asarray((seen - np.asarray(self.shift_mm)) @ rotation_from_vector(self.rotation_deg))


@dataclass(frozen=True, kw_only=True)
class Scale(ChainEffect):
    """The tracker's lengths are off: seen = origin + scale (place - origin).

    `scale`: factor on lengths; `origin_mm`: the point that keeps its place, mm.
    """

    id: ClassVar[str] = "scale"
    scale: float = number("factor", above=0.0)
    origin_mm: Vector = numbers("point that stays", 3, default=(0.0, 0.0, 0.0))

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the reported places (n_frames, n_markers, 3), mm: the true ones, stretched about the origin."""
        origin = np.asarray(self.origin_mm)
        return np.asarray(origin + self.scale * (places - origin))

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true places (n_frames, n_markers, 3), mm, from reported ones: the stretch undone."""
        origin = np.asarray(self.origin_mm)
        return np.asarray(origin + (seen - origin) / self.scale)


@dataclass(frozen=True, kw_only=True)
class Latency(ChainEffect):
    """The tracker is late: at time t it sees the places of t - latency; before the first frame, those of the first."""

    id: ClassVar[str] = "latency"
    latency_s: float = number("delay; negative: early")

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the reported places (n_frames, n_markers, 3), mm: those of an earlier time, linear between frames."""
        return _at(times - self.latency_s, places, times)

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true places (n_frames, n_markers, 3), mm: those reported `latency_s` later, linear between frames.

        After the last frame its places are used.
        """
        return _at(times + self.latency_s, seen, times)


@dataclass(frozen=True, kw_only=True)
class MarkerSlip(ChainEffect):
    """From a time on, through all later cases, a marker has slipped from its place.

    `marker`: its name; `offset_mm`: vector from its old to its new place, mm; `from_time_s`: the time, s.
    """

    id: ClassVar[str] = "marker_slip"
    repeatable: ClassVar[bool] = True
    marker: str = text("name of the marker")
    offset_mm: Vector = numbers("from its place to where it sits", 3)
    from_time_s: float = number("from this moment on")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the experiment has no marker of this name."""
        _known(experiment, "marker", self.marker)

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the reported places (n_frames, n_markers, 3), mm: the marker is moved from `from_time_s` on."""
        return self._moved(places, times, names, 1.0)

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true places (n_frames, n_markers, 3), mm, from reported ones: the marker is moved back."""
        return self._moved(seen, times, names, -1.0)

    def _moved(self, places: FloatArray, times: FloatArray, names: Sequence[str], sign: float) -> FloatArray:
        moved: FloatArray = places.copy()
        moved[times >= self.from_time_s, names.index(self.marker)] += sign * np.asarray(self.offset_mm)
        return moved


@dataclass(frozen=True, kw_only=True)
class MarkerSwap(ChainEffect):
    """From a time on, through all later cases, two markers are taken for each other.

    `markers`: names of the two; `from_time_s`: the time, s.
    """

    id: ClassVar[str] = "marker_swap"
    repeatable: ClassVar[bool] = True
    markers: tuple[str, ...] = texts("names of the two", length=2)
    from_time_s: float = number("from this moment on")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the experiment lacks one of the two markers."""
        for marker in self.markers:
            _known(experiment, "markers", marker)

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the reported places (n_frames, n_markers, 3), mm: the markers are exchanged from `from_time_s` on."""
        one, other = (names.index(marker) for marker in self.markers)
        rows = times >= self.from_time_s
        swapped: FloatArray = places.copy()
        swapped[rows, one], swapped[rows, other] = places[rows, other], places[rows, one]
        return swapped

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true places (n_frames, n_markers, 3), mm, from reported ones: the markers exchanged back."""
        return self.seen(seen, times, names)


def _known(experiment: Experiment, key: str, marker: str) -> None:
    if marker not in experiment.marker_names:
        refuse(f"`{key}` must be among {', '.join(experiment.marker_names)}", marker)


def _at(moments: FloatArray, values: FloatArray, times: FloatArray) -> FloatArray:
    """Return values (n_frames, ...), given at `times`, s, at `moments`, s: linear between frames, constant beyond."""
    later = np.clip(np.searchsorted(times, moments), 0, len(times) - 1)
    earlier = np.maximum(later - 1, 0)
    step = np.where(later > earlier, times[later] - times[earlier], 1.0)
    weight = np.clip((moments - times[earlier]) / step, 0.0, 1.0)
    # At the time of a frame its value alone counts: a missing neighbour must not make it NaN.
    earlier, later = np.where(weight == 1.0, later, earlier), np.where(weight == 0.0, earlier, later)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - weight) * values[earlier] + weight * values[later])
