"""Springs under a body, as the compiled solver takes them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissuereg._base.arguments import each
from tissuereg._base.arrays import FloatArray, IntArray, depth, float_array, index_array
from tissuereg.errors import ArgumentError


def core_springs(springs: Sequence[tuple[Any, Any]]) -> list[tuple[IntArray, list[float]]]:
    """Return sets of springs checked.

    `springs`: surface triangles with the stiffness along the normal and in the plane in kPa/mm. Result: in the same
    order. Raises `ShapeError` if triangles or stiffness have another shape.
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
    """Return the stiffness of springs; None where absent, each member's alike where the member axis is absent.

    `stiffness`: stiffness along the normal and in the plane of every set in kPa/mm; `shape`: wanted shape: (n_sets, 2)
    or (n_members, n_sets, 2). Result: in the wanted shape. Raises `ShapeError` if it cannot have that shape.
    """
    if stiffness is None:
        return None
    if len(shape) == 3 and depth("springs", stiffness) == 2 and shape[0] is not None:
        stiffness = np.broadcast_to(np.asarray(stiffness), (shape[0], *np.shape(stiffness)))
    return float_array("springs", stiffness, shape)
