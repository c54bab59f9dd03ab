"""All measured numbers of an experiment as one flat vector, and columns of smooth changes of them.

The vector (size,) has markers, displacements in mm, and forces, in mN, of all cases in a fixed order. A column is such
a vector: a Gaussian-process pattern over the markers times a history over the frames of a case. The generic rival is a
hypothesis of such columns for any smooth change, without a physical cause. Single frames may be displaced in it as if
the actuator had jammed. Its size is unknown: the evidence is the mean over several sizes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, NuisanceSettings, OutsideSettings, ShapeSettings
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Experiment

_T = TypeVar("_T", bound=np.generic)

#: Places whose patterns are computed at a time, to bound memory.
_AT_A_TIME = 20_000

#: Singular values below this share of the largest are taken for zero.
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class CasePart:
    """Where the numbers of one case lie in the flat vector of all measured numbers.

    `name`: name of the case; `times` (n_frames,): s; `pads`: actuators whose force was measured in it; `begin`: index
    of its first entry; coordinates of markers come first, (n_frames, n_markers, 3), then forces, (n_frames, n_pads, 3);
    `n_markers`: number of markers.
    """

    name: str
    times: FloatArray
    pads: tuple[str, ...]
    begin: int
    n_markers: int

    @property
    def n_frames(self) -> int:
        """Number of frames of the case."""
        return len(self.times)

    @property
    def middle(self) -> int:
        """Index of the case's first force in the flat vector; its markers lie before it."""
        return self.begin + 3 * self.n_frames * self.n_markers

    @property
    def end(self) -> int:
        """Index in the flat vector one past the case's last entry."""
        return self.middle + 3 * self.n_frames * len(self.pads)

    def markers(self, flat: NDArray[_T]) -> NDArray[_T]:
        """Return the case's markers in flat vectors (..., size): a view of shape (..., n_frames, n_markers, 3)."""
        return flat[..., self.begin : self.middle].reshape(*flat.shape[:-1], self.n_frames, self.n_markers, 3)

    def forces(self, flat: NDArray[_T]) -> NDArray[_T]:
        """Return the case's forces in flat vectors (..., size): a view of shape (..., n_frames, n_pads, 3)."""
        return flat[..., self.middle : self.end].reshape(*flat.shape[:-1], self.n_frames, len(self.pads), 3)

    def put(self, flat: NDArray[_T], history: NDArray[_T]) -> None:
        """Write the values of all frames, (n_frames,), into the case's numbers of a flat vector (size,)."""
        self.markers(flat)[:] = history[:, None, None]
        self.forces(flat)[:] = history[:, None, None]


class SignalLayout:
    """The order of all measured numbers of an experiment in one flat vector.

    Raises `ExperimentError` if nothing was measured. Attributes: `parts`: for each case, in the experiment's order,
    where its numbers lie; `size`: length of the vector; `measured` (size,): displacements of markers from their
    reference places in mm, and forces in mN; NaN = not measured.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.marker_names = experiment.marker_names
        self.reference = experiment.marker_reference
        parts, at = [], 0
        for name, case in experiment.cases.items():
            # In the order of the actuators, not of the file of forces: cached banks depend on it.
            known = case.forces.keys() & case.displacements.keys()
            pads = tuple(pad.name for pad in experiment.actuators if pad.name in known)
            part = CasePart(name, case.times, pads, at, len(self.marker_names))
            parts.append(part)
            at = part.end
        self.parts = tuple(parts)
        self.size = at
        markers = {name: case.markers for name, case in experiment.cases.items()}
        self.measured = self.flatten(markers, {name: case.forces for name, case in experiment.cases.items()})
        if not np.isfinite(self.measured).any():
            name = experiment.name
            message = f"experiment '{name}' must have measured markers or forces to be diagnosed; it has none"
            raise ExperimentError(message, where=name)

    def __getitem__(self, name: str) -> CasePart:
        """Return where the numbers of a case lie, by its name."""
        return next(part for part in self.parts if part.name == name)

    @property
    def seen(self) -> BoolArray:
        """Mask (size,) of the entries that were measured."""
        return np.isfinite(self.measured)

    def of_markers(self) -> BoolArray:
        """Return a mask (size,) of the entries that are coordinates of markers."""
        chosen = np.zeros(self.size, bool)
        for part in self.parts:
            chosen[part.begin : part.middle] = True
        return chosen

    def of_case(self, name: str) -> BoolArray:
        """Return a mask (size,) of the entries that belong to a case."""
        chosen = np.zeros(self.size, bool)
        chosen[self[name].begin : self[name].end] = True
        return chosen

    def times(self) -> FloatArray:
        """Return the time of every entry in s, shape (size,)."""
        moments = np.zeros(self.size)
        for part in self.parts:
            part.put(moments, part.times)
        return moments

    def flatten(self, places: Mapping[str, FloatArray], forces: Mapping[str, Mapping[str, FloatArray]]) -> FloatArray:
        """Return predictions as a flat vector (size,): displacements of markers in mm, and forces in mN.

        `places`: by case, (n_frames, n_markers, 3), places of markers, mm; `forces`: by case and pad, (n_frames, 3),
        force on the body, mN.
        """
        flat = np.zeros(self.size)
        for part in self.parts:
            part.markers(flat)[:] = places[part.name] - self.reference
            for i, pad in enumerate(part.pads):
                part.forces(flat)[:, i] = forces[part.name][pad]
        return flat


def smooth_patterns(places: FloatArray, extent: float, settings: NuisanceSettings) -> FloatArray:
    """Return the leading eigenvectors of a Gaussian process of unit variance over places.

    `places` (n, 3) and `extent` of the body: mm. Result: (n_patterns, n), dimensionless, scaled by the roots of the
    eigenvalues, so that their squares sum to nearly 1 at every place.
    """
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * (distance / (settings.pattern_length * extent)) ** 2))
    chosen = np.argsort(values)[::-1][: settings.patterns]
    return np.asarray((np.sqrt(np.maximum(values[chosen], 0.0)) * vectors[:, chosen]).T)


def thinned_patterns(places: FloatArray, length: float, rules: OutsideSettings | ShapeSettings) -> FloatArray:
    """Return the leading patterns (n_patterns, n) of a Gaussian process of unit variance over places (n, 3) in mm.

    `length`: its correlation length, mm. More than `most_places` are thinned out evenly to compute the patterns
    (Nystrom approximation), which represent `held_variance` with `most_patterns` at most.
    """
    known = places[:: -(-len(places) // rules.most_places)]

    def alike(of: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-0.5 * cdist(of, known, "sqeuclidean") / length**2))

    values, vectors = np.linalg.eigh(alike(known))
    values, vectors = values[::-1], vectors[:, ::-1]
    enough = int(np.searchsorted(np.cumsum(values), rules.held_variance * values.sum())) + 1
    chosen = slice(min(enough, rules.most_patterns))
    shapes = vectors[:, chosen] / np.sqrt(values[chosen])
    parts = (places[first : first + _AT_A_TIME] for first in range(0, len(places), _AT_A_TIME))
    return np.concatenate([alike(part) @ shapes for part in parts]).T


def load_history(part: CasePart, base: FloatArray) -> FloatArray:
    """Return the predicted size of the marker motion in every frame over its largest, (n_frames,); 0 in a case at rest.

    `base` (size,): prediction of the believed model, mm and mN.
    """
    moved = np.sqrt((part.markers(base) ** 2).sum(axis=(1, 2)))
    return np.asarray(moved / moved.max()) if moved.max() > 1e-6 else np.zeros(part.n_frames)


def marker_columns(layout: SignalLayout, part: CasePart, history: FloatArray, patterns: FloatArray) -> FloatArray:
    """Return flat vectors of all measured numbers in which the markers of one case move by a pattern times a history.

    `history` (n_frames,) for all markers, or (n_frames, n_markers) for each, mm; `patterns` (n_patterns, n_markers):
    factor at every marker. Result: (3, n_patterns, size), in mm, for motions along x, y and z; zero outside the case.
    """
    columns = np.zeros((3, len(patterns), layout.size))
    for axis in range(3):
        part.markers(columns)[axis, ..., axis] = history.reshape(part.n_frames, -1) * patterns[:, None, :]
    return columns


def force_columns(layout: SignalLayout, part: CasePart, pad: int, history: FloatArray) -> FloatArray:
    """Return vectors (3, size), mN, in which one component of a pad's force in one case follows a history (n_frames,).

    `pad`: number of the pad in `part.pads`; `history`: mN.
    """
    columns = np.zeros((3, layout.size))
    for axis in range(3):
        part.forces(columns)[axis, :, pad, axis] = history
    return columns


def orthonormal(columns: FloatArray) -> FloatArray:
    """Return orthonormal rows (m, size) that span the same space as the given vectors (k, size), with m at most k."""
    lengths = np.linalg.norm(columns, axis=1)
    columns = columns[lengths > 0.0] / lengths[lengths > 0.0, None]
    if not len(columns):
        return columns
    return spanning(columns)


def spanning(rows: FloatArray, least: float = _LEAST) -> FloatArray:
    """Return orthonormal rows (m, size) that span rows (k, size), without singular values below a share of the largest.

    `least`: that share; k is not 0.
    """
    _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[sizes > least * sizes[0]])


def generic_columns(
    layout: SignalLayout, base: FloatArray, extent: float, marker_std: float, settings: DiagnoseSettings = DEFAULT
) -> FloatArray:
    """Return the changes that the generic rival, smooth and without a physical cause, makes, for several sizes of it.

    `base` (size,): prediction of the believed model, mm and mN; `extent`: of the body, mm; `marker_std`: typical noise
    of a coordinate, mm. Result: (n_sizes, p, size), changes of all measured numbers by one prior standard deviation of
    each of the rival's p amplitudes, mm and mN.
    """
    rules, patterns = settings.evidence, smooth_patterns(layout.reference, extent, settings.nuisances)
    markers: list[FloatArray] = []
    forces: list[FloatArray] = []
    jams: list[FloatArray] = []
    for part in layout.parts:
        for history in histories(part, base, rules.fading):
            markers += list(marker_columns(layout, part, history, patterns).reshape(-1, layout.size))
            for i in range(len(part.pads)):
                largest = np.abs(part.forces(base)[:, i]).max()
                forces += list(force_columns(layout, part, i, history * largest))
        change = np.diff(part.markers(base), axis=0)
        for frame in range(1, part.n_frames):
            if np.abs(change[frame - 1]).max() > rules.jam_above * marker_std:
                column = np.zeros(layout.size)
                part.markers(column)[frame] = rules.jam * change[frame - 1]
                part.forces(column)[frame] = rules.jam * np.diff(part.forces(base), axis=0)[frame - 1]
                jams.append(column)
    smooth, strong, steps = (np.array(columns).reshape(-1, layout.size) for columns in (markers, forces, jams))
    each = [np.concatenate([size * marker_std * smooth, share * strong, steps]) for size, share in rules.generic_sizes]
    return np.array(each, np.float32).astype(np.float64)


def histories(part: CasePart, base: FloatArray, fading: float = DEFAULT.evidence.fading) -> list[FloatArray]:
    """Return the time histories, each (n_frames,), dimensionless, that a generic change may have in a case.

    They are load, load squared (minus load), fading memory of the load, clock and constant; without load only a
    constant and the clock. `base` (size,): prediction of the believed model, mm and mN; `fading`: time in which the
    memory fades, over the duration of the case.
    """
    load = load_history(part, base)
    span = float(part.times[-1] - part.times[0]) if part.n_frames > 1 else 1.0
    clock = (part.times - part.times[0]) / max(span, 1e-9)
    if not load.any():
        return [np.ones(part.n_frames), clock - 0.5]
    memory = np.zeros(part.n_frames)
    for frame in range(1, part.n_frames):
        fade = np.exp(-(part.times[frame] - part.times[frame - 1]) / max(fading * span, 1e-9))
        memory[frame] = fade * memory[frame - 1] + (1.0 - fade) * load[frame]
    return [load, load**2 - load, memory, clock, np.ones(part.n_frames)]
