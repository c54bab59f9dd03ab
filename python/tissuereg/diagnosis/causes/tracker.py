"""Errors of the marker tracker: frame, scale, delay, slipped markers, exchanged markers.

All of them change the predicted places in closed form; nothing is solved.
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import three
from tissuereg.experiment.effects import Effect, Frame, Latency, MarkerSlip, MarkerSwap, Scale, seen_markers
from tissuereg.experiment.effects.base import rotation_from_vector


@dataclass(frozen=True)
class FrameCause(Cause, id="frame", family="tracker"):
    """The tracker's frame is shifted and rotated, by more than its prior as a nuisance allows."""

    #: Prior deviations of the shift, mm, and of the rotation, degrees.
    shift_mm: float = 0.5
    turn_deg: float = 0.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, with columns (6, size): the frame is shifted, and rotated about the mean place."""
        scale = np.array([self.shift_mm] * 3 + [self.turn_deg] * 3)
        return [Variant("frame", scale[:, None] * [changed_by(bench, _frame(bench, axis)) for axis in np.eye(6)])]

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return six free parameters: shifts in mm, then a rotation vector in degrees about the mean marker place."""
        scale = np.array([self.shift_mm] * 3 + [self.turn_deg] * 3)
        pose = [(s * a, 0.0, s, 0.05) for s, a in zip(scale, amplitudes, strict=True)]
        return free_parameters(pose, lambda x, young: (_frame(bench, x),))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted rotation vector `rotation_deg`."""
        turn = float(np.linalg.norm(np.asarray(values["rotation_deg"])))
        return f"The tracker's frame is rotated by {turn:.2f} degrees against the mesh's, and shifted."


@dataclass(frozen=True)
class ScaleCause(Cause, id="scale", family="tracker"):
    """The tracker's lengths have a wrong scale, about any origin."""

    #: Prior deviations of the scale, and of the shift, mm.
    scale: float = 0.01
    shift_mm: float = 0.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, with columns (4, size): a wrong scale about the mean place, and three shifts."""
        scale = changed_by(bench, Scale(scale=1.01, origin_mm=three(_middle(bench)))) * 100.0 * self.scale
        shifts = [self.shift_mm * changed_by(bench, Frame(shift_mm=three(axis))) for axis in np.eye(3)]
        return [Variant("scale", np.array([scale, *shifts]))]

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return four free parameters: the scale minus one, about the mean marker place, then three shifts in mm."""
        spread = np.array([self.scale, self.shift_mm, self.shift_mm, self.shift_mm])

        def effect(x: FloatArray, young: float) -> tuple[Scale]:
            # A scale 1 + s about the middle m with a shift d is a scale about m - d / s.
            stretch = float(x[0]) if abs(x[0]) > 1e-6 else 1e-6
            return (Scale(scale=1.0 + stretch, origin_mm=three(_middle(bench) - x[1:] / stretch)),)

        return free_parameters([(s * a, 0.0, s, 0.1 * s) for s, a in zip(spread, amplitudes, strict=True)], effect)

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted factor `scale` on all lengths."""
        return f"The tracker's lengths are wrong by {100 * (values['scale'] - 1):+.2f} %."


@dataclass(frozen=True)
class LatencyCause(Cause, id="latency", family="tracker"):
    """Markers are recorded with a delay."""

    #: Prior deviation of the delay, in frames.
    delay: float = 0.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: a delay of half the time between frames; none for single frames or a believed one."""
        delay = self.delay * bench.frame_step
        if delay == 0.0 or self.believed(bench):
            return []
        return [Variant("delay", changed_by(bench, Latency(latency_s=delay))[None])]

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the delay in units of half the time between frames."""
        unit = self.delay * bench.frame_step
        delay = (float(amplitudes[0]), 0.0, 1.0, 0.1)
        return free_parameters([delay], lambda x, young: (Latency(latency_s=unit * float(x[0])),))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted delay `latency_s` (s)."""
        return f"Markers are delayed by {1000 * values['latency_s']:.0f} ms against the actuators' clock."


@dataclass(frozen=True)
class SlipCause(Cause, id="marker_slip", family="tracker", discrete=("marker", "onset"), constant=False):
    """One marker is displaced on the body from some time on."""

    #: Prior deviation of a slip, mm.
    slip_mm: float = 1.0
    #: Number of onsets of a slip in each case, the first at its begin.
    onsets: int = 4

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, with columns (3, size), for each marker and each of several times of its slip."""
        slips = itertools.product(_onsets(bench, self.onsets), bench.layout.marker_names)
        return (self._slip(bench, marker, onset) for onset, marker in slips)

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the hypotheses that the marker slips at another frame between the neighbouring screened times."""
        screened, mine = _onsets(bench, self.onsets), float(variant.settings["onset"])
        before = max((onset for onset in screened if onset < mine), default=-np.inf)
        after = min((onset for onset in screened if onset > mine), default=np.inf)
        frames = sorted({float(time) for part in bench.layout.parts for time in part.times})
        onsets = (time for time in frames if before < time < after and time != mine)
        return tuple(self._slip(bench, str(variant.settings["marker"]), onset) for onset in onsets)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return three free parameters: the offset of the marker along x, y and z in mm."""
        marker, onset = str(variant.settings["marker"]), float(variant.settings["onset"])
        return free_parameters(
            [(self.slip_mm * float(a), 0.0, self.slip_mm, 0.1) for a in amplitudes],
            lambda x, young: (MarkerSlip(marker=marker, offset_mm=three(x), from_time_s=onset),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `offset_mm` and `from_time_s` of a `marker`."""
        size = float(np.linalg.norm(np.asarray(values["offset_mm"])))
        return f"Marker '{values['marker']}' has slipped by {size:.2f} mm, from {values['from_time_s']:.4g} s on."

    def _slip(self, bench: Bench, marker: str, onset: float) -> Variant:
        """Return the hypothesis that `marker` slips at the time `onset` (s), with one column for each axis."""
        later, number = bench.layout.times() >= onset, bench.layout.marker_names.index(marker)
        columns = np.zeros((3, bench.layout.size))
        for part in bench.layout.parts:
            for axis in range(3):
                part.markers(columns)[axis, :, number, axis] = part.markers(later)[:, number, axis]
        return Variant(f"{marker} from {onset:.4g} s", self.slip_mm * columns, {"marker": marker, "onset": onset})


@dataclass(frozen=True)
class SwapCause(Cause, id="marker_swap", family="tracker", discrete=("pair", "onset")):
    """Two markers are mistaken for each other from some time on."""

    #: Number of pairs of markers with a hypothesis of exchange.
    pairs: int = 15

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each frame and each likely pair of markers: they are exchanged from then on."""
        for onset in sorted({float(time) for part in bench.layout.parts for time in part.times}):
            for pair in _likely_pairs(bench, self.pairs):
                changed = changed_by(bench, MarkerSwap(markers=pair, from_time_s=onset))
                label = f"{pair[0]} and {pair[1]} from {onset:.4g} s"
                yield Variant(label, changed[None], {"pair": pair, "onset": onset}, fixed=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return no free parameters (k = 0): the pair of markers and the time of the exchange are fixed."""
        swap = MarkerSwap(markers=tuple(variant.settings["pair"]), from_time_s=float(variant.settings["onset"]))
        return free_parameters([], lambda x, young: (swap,))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `markers` (two names) and `from_time_s`."""
        one, other = values["markers"]
        return f"Markers '{one}' and '{other}' are exchanged from {values['from_time_s']:.4g} s on."


def _likely_pairs(bench: Bench, most: int) -> list[tuple[str, str]]:
    """Return the names of the pairs of markers that are most likely exchanged, likeliest first."""
    names = bench.layout.marker_names
    own, other = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for part in bench.layout.parts:
        predicted = bench.layout.reference + part.markers(bench.base)
        measured = bench.layout.reference + part.markers(bench.layout.measured)
        apart = np.linalg.norm(np.nan_to_num(measured[:, :, None] - predicted[:, None], nan=0.0), axis=3)
        own += np.einsum("fii->i", apart)
        other += apart.sum(axis=0)
    # Distances of measured from predicted places, over those from the places of the other marker.
    ratio = (own[:, None] + own) / np.maximum(other + other.T, 1e-9)
    pairs = sorted(itertools.combinations(range(len(names)), 2), key=lambda pair: -ratio[pair])
    return [(names[i], names[j]) for i, j in pairs[:most]]


def changed_by(bench: Bench, effect: Effect) -> FloatArray:
    """Return the change (size,) of the believed prediction by an error of the tracker: mm (markers), 0 (forces)."""
    tracker = replace(bench.experiment, effects=(effect,))
    changed = np.zeros(bench.layout.size)
    for part in bench.layout.parts:
        places = bench.layout.reference + part.markers(bench.base)
        part.markers(changed)[:] = seen_markers(tracker, places, part.times) - places
    return changed


def _frame(bench: Bench, x: FloatArray) -> Frame:
    """Return the tracker's frame shifted by x[:3] mm and rotated by x[3:] degrees about the markers' mean place."""
    turn, middle = rotation_from_vector(three(x[3:])), _middle(bench)
    return Frame(rotation_deg=three(x[3:]), shift_mm=three(x[:3] + middle - turn @ middle))


def _middle(bench: Bench) -> FloatArray:
    return np.asarray(bench.layout.reference.mean(axis=0))


def _onsets(bench: Bench, per_case: int) -> list[float]:
    found: set[float] = set()
    for part in bench.layout.parts:
        found |= {*part.times[np.linspace(0, part.n_frames - 1, per_case + 1).astype(int)[:-1]].tolist()}
    return sorted(found)
