"""Unlabelled points measured on the deformed surface of a body; which point of the body each one is, is unknown."""

from typing import Any

import numpy as np

from tissuereg._base.arguments import found, real
from tissuereg._base.arrays import FloatArray, IntArray, float_array, frozen
from tissuereg._base.provenance import derived
from tissuereg.errors import SurfaceError

#: More points than this are thinned evenly.
MOST_POINTS = 500

#: More than this are thinned by a stride before they are thinned evenly.
_MOST_COMPARED = 20_000


class SurfacePoints:
    """Points measured on the deformed surface of a body at one moment, without labels.

    Parameters
    ----------
    measured : array_like of float, shape (n, 3)
        Places on all or part of the deformed surface, mm. Rows with NaN are ignored.
    std : float
        Standard deviation of the measured place of a point along the surface's normal, mm.

    Raises
    ------
    ShapeError
        If `measured` has another shape.
    SurfaceError
        If there are fewer than three points, a coordinate is infinite, or `std` is not positive.

    Attributes
    ----------
    places : ndarray of float64, shape (n_points, 3)
        The points that are used, mm: at most `MOST_POINTS`, spread evenly over the given points.
    rows : ndarray of int64, shape (n_points,)
        Indices of these points among the given ones.
    std : float
        The argument `std`, mm.
    given : int
        Number of given points without NaN, before thinning.

    Examples
    --------
    >>> SurfacePoints([[0, 0, 1.0], [1, 0, 1], [0, 1, 1]], std=0.2)
    SurfacePoints(3 points, std 0.2 mm)
    """

    def __init__(self, measured: Any, std: float = 0.1) -> None:
        places = float_array("surface", measured, (None, 3))
        if np.isinf(places).any():
            row = int(np.argmax(np.isinf(places).any(axis=1)))
            message = f"surface points must be finite, got {places[row].tolist()} in row {row}"
            raise SurfaceError(message, where="surface")
        whole = np.flatnonzero(np.isfinite(places).all(axis=1))
        places = places[whole]
        if len(places) < 3:
            message = f"a surface must be given by at least 3 points, got {len(places)}"
            raise SurfaceError(message, where="surface")
        std = _positive(std)
        self.given = len(places)
        kept = evenly(places, MOST_POINTS)
        self.places: FloatArray = frozen(np.ascontiguousarray(places[kept]))
        self.rows: IntArray = frozen(whole[kept])
        self.std = std
        derived(self, measured)

    def __len__(self) -> int:
        return len(self.places)

    def __repr__(self) -> str:
        return f"SurfacePoints({len(self)} points, std {self.std:g} mm)"


def _positive(std: Any) -> float:
    """Return `std` in mm as a float; raise SurfaceError unless it is above 0 and below 1e9 (its square is finite)."""
    try:
        return real("std", std, above=0.0, below=1e9, error=SurfaceError)
    except SurfaceError:
        message = f"`std` must be positive, in mm, and below 1e9 mm, got {found(std)}"
        raise SurfaceError(message, where="std") from None


def evenly(places: FloatArray, count: int) -> IntArray:
    """Return the sorted indices of at most `count` of the given places, spread evenly by farthest-point sampling.

    `places` (n, 3): mm. Each chosen place is the farthest from those chosen before it. Result: int64 (min(n, count),).
    Many thousands of places are first thinned by a constant stride.
    """
    if len(places) <= count:
        return np.arange(len(places))
    among = np.arange(0, len(places), max(1, len(places) // _MOST_COMPARED))
    compared = places[among]
    chosen = [int(np.argmax(np.sum((compared - compared.mean(axis=0)) ** 2, axis=1)))]
    gap = np.sum((compared - compared[chosen[0]]) ** 2, axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.sum((compared - compared[chosen[-1]]) ** 2, axis=1))
    return np.asarray(np.sort(among[chosen]), np.int64)
