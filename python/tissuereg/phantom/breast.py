"""The breast phantom's body as an implicit function, and meshes of any number of nodes inside it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tissuereg._base.arguments import whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import MeshError
from tissuereg.phantom.stuffing import stuffed


@dataclass(frozen=True)
class BreastShape:
    """Dimensions of the breast phantom, and rules of the search for a mesh with a wanted number of nodes.

    The body stands on the chest wall z = 0. `radius_mm`, `height_mm`: radius at the chest wall, and height above it;
    `droop_mm`: how far the apex hangs down; `fuller`: how much fuller the lower half is, as a share of the radius;
    `share`, `share_coarse`: allowed relative deviation from the number of nodes, above and below `coarse` nodes;
    `tries`, `near`: lattice constants tried on the way to that number, and on each side of the last one; `least`,
    `most`: bounds of the number of nodes.
    """

    radius_mm: float = 60.0  # at the chest wall
    height_mm: float = 52.0  # above the chest wall
    droop_mm: float = 7.0  # how far the apex hangs down
    fuller: float = 0.06  # how much fuller the lower half is, share of the radius
    share: float = 0.02  # a mesh has as many nodes as were wanted but for this share
    share_coarse: float = 0.04  # or this one, below `coarse` nodes
    coarse: int = 1000  # below so many nodes a coarse lattice gains and loses many at once
    tries: int = 8  # sizes of the lattice that are tried towards the number of nodes
    near: int = 40  # and on each side of the last of these
    least: int = 100  # fewest nodes of a mesh
    most: int = 200_000  # and most


BREAST = BreastShape()


def inside_breast(points: FloatArray) -> FloatArray:
    """Return the depth (n,) in mm of points (n, 3) in mm below the skin, measured in their horizontal section.

    That is the radius of the skin in the point's direction minus the point's own radius; it is negative outside. The
    height above the chest wall is z.
    """
    x, y, z = points.T
    height = z / BREAST.height_mm
    elevation = np.arcsin(np.clip(height, -1.0, 1.0))
    y = y + BREAST.droop_mm * height**2
    own = np.hypot(x, y)
    sine = np.divide(y, own, out=np.zeros_like(own), where=own > 0.0)
    fuller = 1.0 + BREAST.fuller * np.sin(2.0 * elevation) * (1.0 - sine) / 2.0
    return np.asarray(
        np.where(height < 1.0, BREAST.radius_mm * np.cos(elevation) * fuller - own, -own - (z - BREAST.height_mm))
    )


def breast_mesh(n_nodes: int) -> Mesh:
    """Return a mesh of the phantom's body with about `n_nodes` nodes; its node set ``fixed`` is the chest wall.

    Parameters
    ----------
    n_nodes : int
        Wanted number of nodes, from 100 to 200,000. It is met within 2 %, or 4 % if it is below 1,000.

    Returns
    -------
    Mesh
        Mesh in mm, the same at every call. The meshes of `phantom_mesh` and `truth_mesh` are other ones inside the same
        skin, made by another program.

    Raises
    ------
    ArgumentError
        If the number is out of range.
    MeshError
        If no lattice constant gives a number of nodes so close to the wanted one.
    """
    return _breast_mesh(whole("n_nodes", n_nodes, least=BREAST.least, most=BREAST.most))


@lru_cache(maxsize=2)
def _breast_mesh(n_nodes: int) -> Mesh:
    volume = 2.0 / 3.0 * np.pi * BREAST.radius_mm**2 * BREAST.height_mm
    size = (2.0 * volume / n_nodes) ** (1.0 / 3.0)  # a lattice has two nodes a cube, and the skin some more
    for _ in range(BREAST.tries):
        found = _stuffed(size)
        off = len(found[0]) / n_nodes
        if abs(off - 1.0) < BREAST.share / 2:
            break
        size *= off ** (1.0 / 3.0)
    else:
        # The number jumps with the size: what is near is tried in turn, on both sides.
        near = [_stuffed(size * (1.0 + 0.003 * k)) for k in range(-BREAST.near, BREAST.near + 1)]
        found = min(near, key=lambda one: abs(len(one[0]) - n_nodes))
    share = BREAST.share if n_nodes >= BREAST.coarse else BREAST.share_coarse
    if abs(len(found[0]) / n_nodes - 1.0) > share:
        message = f"no lattice gives {n_nodes} nodes within {share:.0%}; ask for another number"
        raise MeshError(message, where="n_nodes")
    nodes = np.round(found[0], 4)
    return Mesh(nodes, found[1], {"fixed": np.flatnonzero(nodes[:, 2] == 0.0)})


def _stuffed(size: float) -> tuple[FloatArray, IntArray]:
    low = np.array([-1.1 * BREAST.radius_mm, -1.1 * BREAST.radius_mm - BREAST.droop_mm, 0.0])
    high = np.array([1.1 * BREAST.radius_mm, 1.1 * BREAST.radius_mm, BREAST.height_mm])
    return stuffed(inside_breast, low, high, size)
