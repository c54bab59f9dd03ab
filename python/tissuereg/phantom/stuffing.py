"""Tetrahedra inside an implicit surface above the plane z = 0: a lattice is warped to the surface and cut by it.

After Labelle and Shewchuk, "Isosurface stuffing", SIGGRAPH 2007: nodes of a body-centred cubic lattice that lie close
to the surface are moved onto it, so that the parts that the surface cuts off the other tetrahedra have good angles.
Faces that are cut are divided from their node of lowest number on, so that neighbouring tetrahedra agree. Nothing is
random.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray

#: Takes points (n, 3); positive inside.
Inside = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class StuffingRules:
    """Constants of the warp of lattice nodes to the surface and of the search for the surface.

    A node moves if it is closer to the crossing of one of its edges with the surface than a share of the edge's length:
    `warp_long` for edges of the lattice's cubes, `warp_short` for edges from a corner to a centre. `bisections`: number
    of bisection steps that find a crossing.
    """

    warp_long: float = 0.25
    warp_short: float = 0.41
    bisections: int = 45


STUFFING = StuffingRules()


def stuffed(inside: Inside, low: FloatArray, high: FloatArray, size: float) -> tuple[FloatArray, IntArray]:
    """Return nodes (n_nodes, 3) in mm and tets (n_tets, 4) of positive volume that fill a body above the plane z = 0.

    `inside` takes points (n, 3) in mm and gives numbers (n,), positive inside the body, negative outside, continuous;
    the body's surface should stand upright on z = 0. `low` and `high` (3,) are opposite corners of a box around the
    body in mm, ``low[2]`` is 0; `size` is the edge of the lattice's cubes in mm. Nodes on the plane have z = 0 exactly.
    """
    nodes, tets = _lattice(low, high, size)
    sign = np.sign(inside(nodes))
    tets = tets[(sign[tets] > 0).any(axis=1)]
    edges = np.unique(np.sort(tets[:, _EDGES].reshape(-1, 2), axis=1), axis=0)
    crossing = edges[sign[edges].prod(axis=1) < 0]
    cuts, share = _cuts(inside, nodes, crossing, sign)
    nodes, sign = _warped(nodes, sign, crossing, cuts, share, size)
    left = (sign[crossing] != 0).all(axis=1)
    crossing, cuts = crossing[left], cuts[left]
    cut_of = {(int(a), int(b)): len(nodes) + k for k, (a, b) in enumerate(crossing)}
    whole = tets[(sign[tets] >= 0).all(axis=1) & (sign[tets] > 0).any(axis=1)]
    parts = [part for tet in tets[(sign[tets] < 0).any(axis=1)] for part in _part(tet.tolist(), sign, cut_of)]
    found = np.concatenate([whole, np.array(parts, dtype=np.int64).reshape(-1, 4)])
    return _compact(np.concatenate([nodes, cuts]), found)


_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])


def _lattice(low: FloatArray, high: FloatArray, size: float) -> tuple[FloatArray, IntArray]:
    """Return nodes (n, 3), mm, and tets (m, 4) of a body-centred cubic lattice on z >= 0.

    `low`, `high` (3,): opposite corners of the box to fill, mm; `size`: edge of a cube, mm. The plane z = 0 halves the
    lowest tets.
    """
    nx, ny, nz = (int(one) for one in np.ceil((high - low) / size) + 1)
    start = np.array([*(0.5 * (low + high - size * np.array([nx, ny, nz])))[:2], 0.0])
    corner = np.arange((nx + 1) * (ny + 1) * (nz + 1)).reshape(nx + 1, ny + 1, nz + 1)
    centre = corner.size + np.arange(nx * ny * nz).reshape(nx, ny, nz)
    below = corner.size + centre.size + np.arange(nx * ny)
    grids = [1.0 * np.indices(corner.shape), np.indices(centre.shape) + 0.5, np.indices((nx, ny, 1)) + 0.5]
    grids[2][2] = 0.0
    nodes = start + size * np.concatenate([grid.reshape(3, -1).T for grid in grids])
    tets = []
    for axis in range(3):
        one, other = (np.moveaxis(centre, axis, 0)[s].ravel() for s in (slice(None, -1), slice(1, None)))
        tets += _around(np.moveaxis(corner, axis, 0)[1:-1], one, other)
    tets += _around(np.moveaxis(corner, 2, 0)[:1], below, centre[:, :, 0].ravel())
    return nodes, np.concatenate(tets)


def _around(layers: IntArray, one: IntArray, other: IntArray) -> list[IntArray]:
    """Return the four tets around each of k lattice squares as four arrays (k, 4) of node indices.

    Each tet has one side of the square and the two points next to the square. `layers` (l, m, n): node indices of
    square grids; `one`, `other` (k,): node indices of the points on the two sides of each square.
    """
    ring = [layers[:, :-1, :-1], layers[:, 1:, :-1], layers[:, 1:, 1:], layers[:, :-1, 1:]]
    flat = [part.ravel() for part in ring]
    return [np.stack([flat[k], flat[(k + 1) % 4], one, other], axis=1) for k in range(4)]


def _cuts(inside: Inside, nodes: FloatArray, crossing: IntArray, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where edges cross the surface: places (k, 3), mm, and the share (k,) of the edge's length up to there.

    `inside`: function of points (n, 3) that is positive inside; `nodes` (n, 3): mm; `crossing` int64 (k, 2): edges
    whose ends lie on different sides; `sign` (n,): 1 for nodes inside, -1 outside.
    """
    first, second = nodes[crossing[:, 0]], nodes[crossing[:, 1]]
    low, high = np.zeros(len(crossing)), np.ones(len(crossing))
    for _ in range(STUFFING.bisections):
        middle = 0.5 * (low + high)
        same = np.sign(inside(first + middle[:, None] * (second - first))) == sign[crossing[:, 0]]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    share = 0.5 * (low + high)
    return first + share[:, None] * (second - first), share


def _warped(
    nodes: FloatArray, sign: FloatArray, crossing: IntArray, cuts: FloatArray, share: FloatArray, size: float
) -> tuple[FloatArray, FloatArray]:
    """Return nodes (n, 3), mm, and signs (n,) after nodes near the surface were moved onto it.

    Signs are 1 inside, -1 outside, 0 on the surface. `crossing` int64 (k, 2): edges that cross the surface; `cuts` (k,
    3): where, mm; `share` (k,): share of the edge's length up to there; `size`: edge of a cube, mm. Nodes on the plane
    z = 0 stay on it.
    """
    nodes, sign = nodes.copy(), sign.copy()
    length = np.linalg.norm(nodes[crossing[:, 1]] - nodes[crossing[:, 0]], axis=1)
    limit = np.where(length > 0.99 * size, STUFFING.warp_long, STUFFING.warp_short)
    ends = np.concatenate([crossing[:, 0], crossing[:, 1]])
    near = np.concatenate([share, 1.0 - share])
    towards = np.concatenate([cuts, cuts])
    stays = (nodes[ends, 2] > 0.0) | (towards[:, 2] == 0.0)
    chosen = np.flatnonzero((near < np.concatenate([limit, limit])) & stays)
    chosen = chosen[np.lexsort((near[chosen] * np.concatenate([length, length])[chosen], ends[chosen]))]
    moved, first = np.unique(ends[chosen], return_index=True)
    nodes[moved] = towards[chosen[first]]
    sign[moved] = 0.0
    return nodes, sign


def _part(tet: list[int], sign: FloatArray, cut_of: dict[tuple[int, int], int]) -> list[list[int]]:
    """Return the tets, as lists of node indices, that make up the part of one tet inside the surface.

    `tet`: four node indices; `sign` (n,): 1 for nodes inside, -1 outside, 0 on the surface; `cut_of`: index of the node
    at which an edge (lower, higher node index) is cut.
    """
    inner = sorted(v for v in tet if sign[v] > 0)
    on = [v for v in tet if sign[v] == 0]
    outer = [v for v in tet if sign[v] < 0]

    def cut(a: int, b: int) -> int:
        return cut_of[min(a, b), max(a, b)]

    if not inner:
        return []
    if len(inner) == 1:
        return [[inner[0], *on, *(cut(inner[0], v) for v in outer)]]
    if len(inner) == 3:
        return _prism(inner, [cut(v, outer[0]) for v in inner])
    a, b = inner
    if len(outer) == 2:
        return _prism([a, cut(a, outer[0]), cut(a, outer[1])], [b, cut(b, outer[0]), cut(b, outer[1])])
    # A pyramid over the quadrilateral a, b, cut of b, cut of a, divided from a, its first node.
    return [[on[0], a, b, cut(b, outer[0])], [on[0], a, cut(b, outer[0]), cut(a, outer[0])]]


def _prism(one: list[int], other: list[int]) -> list[list[int]]:
    """Divide the prism with edges one[k]-other[k] into three tets; faces are divided from their lowest node on."""
    if min(other) < min(one):
        one, other = other, one
    k = one.index(min(one))
    a, b, c = one[k], one[(k + 1) % 3], one[(k + 2) % 3]
    d, e, f = other[k], other[(k + 1) % 3], other[(k + 2) % 3]
    # The two quadrilaterals at a are divided from a; the third, b c f e, from its own first node.
    middle = [[a, b, c, f], [a, b, f, e]] if min(b, f) < min(c, e) else [[a, b, c, e], [a, c, f, e]]
    return [[a, d, e, f], *middle]


def _compact(nodes: FloatArray, tets: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the nodes (n, 3), mm, that tets use, and the tets (m, 4) of node indices, ordered for positive volume."""
    used, flat = np.unique(tets, return_inverse=True)
    tets, nodes = flat.reshape(tets.shape).astype(np.int64), nodes[used]
    a, b, c, d = (nodes[tets[:, k]] for k in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return nodes, tets
