"""The breast phantom's body as a formula, and meshes of any number of nodes inside it."""

from functools import lru_cache

import numpy as np

from tissuereg._base.arguments import whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import MeshError
from tissuereg.phantom.stuffing import stuffed

#: Radius at the chest wall, height above it, and how far the apex hangs down, mm.
RADIUS, HEIGHT, DROOP = 60.0, 52.0, 7.0

#: How much fuller the lower half is, as a share of the radius.
_FULLER = 0.06

#: A mesh has as many nodes as were asked for, but for this share; a coarse lattice gains and loses many at once.
_SHARE, _SHARE_COARSE, _COARSE = 0.02, 0.04, 1000

#: Sizes of the lattice that are tried towards the number of nodes, and on each side of the last of these.
_TRIES, _NEAR = 8, 40

_LEAST, _MOST = 100, 200_000


def inside_breast(points: FloatArray) -> FloatArray:
    """Return how deep points lie inside the body, in its horizontal sections.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        In mm; z is the height above the chest wall.

    Returns
    -------
    ndarray of float64, shape (n,)
        Radius of the skin in the point's direction less the point's own, mm; negative outside.
    """
    x, y, z = points.T
    height = z / HEIGHT
    elevation = np.arcsin(np.clip(height, -1.0, 1.0))
    y = y + DROOP * height**2
    own = np.hypot(x, y)
    sine = np.divide(y, own, out=np.zeros_like(own), where=own > 0.0)
    fuller = 1.0 + _FULLER * np.sin(2.0 * elevation) * (1.0 - sine) / 2.0
    return np.asarray(np.where(height < 1.0, RADIUS * np.cos(elevation) * fuller - own, -own - (z - HEIGHT)))


def breast_mesh(n_nodes: int) -> Mesh:
    """Return a mesh of the phantom's body with about so many nodes; the node set ``fixed`` is the chest wall.

    Parameters
    ----------
    n_nodes : int
        Wanted number, from 100 to 200,000; it is met within 2 %, below 1,000 within 4 %.

    Returns
    -------
    Mesh
        The same at every call. Not the meshes of `phantom_mesh` and `truth_mesh`, which another program made inside
        the same skin.

    Raises
    ------
    ArgumentError
        If the number is out of range.
    MeshError
        If no lattice gives a number so near.
    """
    return _breast_mesh(whole("n_nodes", n_nodes, least=_LEAST, most=_MOST))


@lru_cache(maxsize=2)
def _breast_mesh(n_nodes: int) -> Mesh:
    volume = 2.0 / 3.0 * np.pi * RADIUS**2 * HEIGHT
    size = (2.0 * volume / n_nodes) ** (1.0 / 3.0)  # a lattice has two nodes a cube, and the skin some more
    for _ in range(_TRIES):
        found = _stuffed(size)
        off = len(found[0]) / n_nodes
        if abs(off - 1.0) < _SHARE / 2:
            break
        size *= off ** (1.0 / 3.0)
    else:
        # The number jumps with the size: what is near is tried in turn, on both sides.
        near = [_stuffed(size * (1.0 + 0.003 * k)) for k in range(-_NEAR, _NEAR + 1)]
        found = min(near, key=lambda one: abs(len(one[0]) - n_nodes))
    share = _SHARE if n_nodes >= _COARSE else _SHARE_COARSE
    if abs(len(found[0]) / n_nodes - 1.0) > share:
        message = f"no lattice gives {n_nodes} nodes within {share:.0%}; ask for another number"
        raise MeshError(message, where="n_nodes")
    nodes = np.round(found[0], 4)
    return Mesh(nodes, found[1], {"fixed": np.flatnonzero(nodes[:, 2] == 0.0)})


def _stuffed(size: float) -> tuple[FloatArray, IntArray]:
    low = np.array([-1.1 * RADIUS, -1.1 * RADIUS - DROOP, 0.0])
    high = np.array([1.1 * RADIUS, 1.1 * RADIUS, HEIGHT])
    return stuffed(inside_breast, low, high, size)
