"""Columns of smooth changes: Gaussian-process patterns over the markers times a history over the frames of a case.

A column is a flat vector of all measured numbers, (size,): displacements of markers in mm and forces in mN.
"""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.settings import DEFAULT, NuisanceSettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout

#: Singular values below this share of the largest are taken for zero.
_LEAST = 1e-6


def smooth_patterns(places: FloatArray, extent: float, settings: NuisanceSettings = DEFAULT.nuisances) -> FloatArray:
    """Return the leading eigenvectors of a Gaussian process of unit variance over places.

    `places` (n, 3): mm; `extent`: extent of the body, mm; `settings`: number and length. Result: (n_patterns, n),
    dimensionless, scaled by the roots of the eigenvalues, so that their squares sum to nearly 1 at every place.
    """
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * (distance / (settings.pattern_length * extent)) ** 2))
    chosen = np.argsort(values)[::-1][: settings.patterns]
    return np.asarray((np.sqrt(np.maximum(values[chosen], 0.0)) * vectors[:, chosen]).T)


def load_history(part: CasePart, base: FloatArray) -> FloatArray:
    """Return the predicted size of the marker motion in every frame over its largest, (n_frames,), 0 to 1.

    It is 0 throughout in a case at rest. `part`: the case; `base` (size,): prediction of the believed model, mm and mN.
    """
    moved = np.sqrt((part.markers(base) ** 2).sum(axis=(1, 2)))
    return np.asarray(moved / moved.max()) if moved.max() > 1e-6 else np.zeros(part.n_frames)


def marker_columns(layout: SignalLayout, part: CasePart, history: FloatArray, patterns: FloatArray) -> FloatArray:
    """Return flat vectors of all measured numbers in which the markers of one case move by a pattern times a history.

    `layout`: order of the vectors; `part`: the case, outside which all entries are zero; `history` (n_frames,) for all
    markers, or (n_frames, n_markers) for each, mm; `patterns` (n_patterns, n_markers): factor at every marker. Result:
    (3, n_patterns, size), in mm, for motions along x, y and z.
    """
    columns = np.zeros((3, len(patterns), layout.size))
    for axis in range(3):
        part.markers(columns)[axis, ..., axis] = history.reshape(part.n_frames, -1) * patterns[:, None, :]
    return columns


def force_columns(layout: SignalLayout, part: CasePart, pad: int, history: FloatArray) -> FloatArray:
    """Return flat vectors of all measured numbers in which one component of a pad's force follows a history.

    `layout`: order of the vectors; `part`: the case, outside which all entries are zero; `pad`: number of the pad in
    `part.pads`; `history` (n_frames,): mN. Result: (3, size), in mN, one for each component.
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
    _, sizes, rows = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(rows[sizes > _LEAST * sizes[0]])
