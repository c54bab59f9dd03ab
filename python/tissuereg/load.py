"""What acts on the body in one static event."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Load:
    """Dead loads and prescribed displacements.

    Parameters
    ----------
    forces : array_like of float, shape (n_nodes, 3), optional
        Nodal forces in mN.
    body_force : array_like of float, shape (3,), optional
        Force per undeformed volume in mN/mm^3; `Material.weight` gives gravity's.
    prescribed : array_like of float, shape (n_held, 3), optional
        Displacement in mm of every held node, in the order in which they are held; None holds them still.
    traction : tuple of (array_like of int (n, 3), array_like of float (3,)), optional
        Boundary triangles and the dead traction on them in kPa of undeformed area.
    """

    forces: Any = None
    body_force: Any = None
    prescribed: Any = None
    traction: Any = None
