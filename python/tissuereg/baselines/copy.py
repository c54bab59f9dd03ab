"""A trivial baseline, which does well in easy tests: every point moves by the mean motion of the markers."""

from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, float_array


def copied_displacement(reference: Any, measured: Any, points: Any) -> FloatArray:
    """Return the markers' mean displacement at every point.

    Parameters
    ----------
    reference, measured : array_like of float, shape (n_markers, 3)
        Markers before and after, mm.
    points : array_like of float, shape (n_points, 3)
        Points at which the displacement is evaluated, mm.

    Returns
    -------
    ndarray of float64, shape (n_points, 3)
        mm.
    """
    before = float_array("reference", reference, (None, 3))
    after = float_array("measured", measured, (len(before), 3))
    wanted = float_array("points", points, (None, 3))
    return np.tile((after - before).mean(axis=0), (len(wanted), 1))
