"""The load on the body in one static event."""

from dataclasses import dataclass
from typing import Any

from tissuereg._base.arguments import found
from tissuereg._base.arrays import depth, float_array, index_array
from tissuereg._base.shown import short_repr
from tissuereg.errors import LoadError


@dataclass(frozen=True, eq=False)
class Load:
    """Dead loads on a body and prescribed displacements of its held nodes, in one static state.

    Parameters
    ----------
    forces : array_like of float, shape (n_nodes, 3), optional
        Nodal forces in mN.
    body_force : array_like of float, shape (3,), optional
        Force per undeformed volume in mN/mm^3; `Material.weight` gives gravity's.
    prescribed : array_like of float, shape (n_held, 3), optional
        Displacement in mm of every held node, in the order of the held nodes. Where it is None, held nodes do not move.
    traction : tuple of (array_like of int (n, 3), array_like of float (3,) or (n, 3)), optional
        Boundary triangles as node numbers, and the dead traction on all of them, or on each, in kPa of undeformed area.

    Raises
    ------
    ShapeError
        If a field is not an array of numbers of the shape stated above. The solve checks whether it fits the body.
    LoadError
        If `traction` is not a pair.
    """

    forces: Any = None
    body_force: Any = None
    prescribed: Any = None
    traction: Any = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.forces is not None:
            float_array("forces", self.forces, (None, 3))
        if self.body_force is not None:
            float_array("body_force", self.body_force, (3,))
        if self.prescribed is not None:
            float_array("prescribed", self.prescribed, (None, 3))
        if self.traction is not None:
            triangles, pull = _pair(self.traction)
            index_array("traction", triangles, (None, 3))
            float_array("traction", pull, (None, 3) if depth("traction", pull) == 2 else (3,))


def _pair(traction: Any) -> tuple[Any, Any]:
    if not isinstance(traction, tuple | list) or len(traction) != 2:
        message = f"`traction` must be a pair of triangles and traction, got {found(traction)}"
        raise LoadError(message, where="traction")
    return traction[0], traction[1]
