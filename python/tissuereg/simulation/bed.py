"""Checks of the sets of springs under a body, before they go to the compiled solver."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissuereg._base.arguments import each
from tissuereg._base.arrays import FloatArray, IntArray, depth, float_array, index_array
from tissuereg.errors import ArgumentError


def core_springs(springs: Sequence[tuple[Any, Any]]) -> list[tuple[IntArray, list[float]]]:
    """Return sets of springs as integer and float lists for the compiled solver, after a check of their shapes.

    `springs`: one pair per set, of surface triangles (n, 3), as node numbers, and the stiffness (2,) along the normal
    and in the plane in kPa/mm. Result: the same pairs in the same order. Raises `ArgumentError` if an item is no pair;
    `ShapeError` if triangles or stiffness have another shape.
    """
    pairs = each("springs", springs, (tuple, list))
    if not all(len(pair) == 2 for pair in pairs):
        message = "`springs` must be a list of pairs of triangles and stiffness, got others"
        raise ArgumentError(message, where="springs")
    return [
        (index_array("spring triangles", triangles, (None, 3)), float_array("springs", stiffness, (2,)).tolist())
        for triangles, stiffness in pairs
    ]


def stiffness_array(stiffness: Any, shape: tuple[int | None, ...]) -> FloatArray | None:
    """Return the stiffness of sets of springs as an array, the same for every member if no member axis is given.

    `stiffness`: stiffness along the normal and in the plane of every set in kPa/mm, (n_sets, 2) or (n_members, n_sets,
    2), or None; `shape`: wanted shape, one of these two. Result: in the wanted shape, or None if None is given. Raises
    `ShapeError` if it cannot have that shape.
    """
    if stiffness is None:
        return None
    if len(shape) == 3 and depth("springs", stiffness) == 2 and shape[0] is not None:
        stiffness = np.broadcast_to(np.asarray(stiffness), (shape[0], *np.shape(stiffness)))
    return float_array("springs", stiffness, shape)
