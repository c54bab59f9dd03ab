"""Closing the holes of a surface.

The rim of a hole is the chain of edges that belong to one triangle only. It is closed with the triangles of least total
area that have no further corners [1]_: with ``W[i, j]`` the least area between corners i and j of a rim,

    W[i, j] = min over k of  W[i, k] + W[k, j] + area(i, k, j),      i < k < j,

a table of n^2 entries that costs n^3 / 6 areas. A rim of too many corners gets a fan about its middle.

References
----------
.. [1] G. Barequet and M. Sharir, "Filling gaps in the boundary of a polyhedron", Computer Aided Geometric Design 12,
   207-229, 1995. doi:10.1016/0167-8396(94)00011-G
"""

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.triangles import Triangles, triangle_areas
from tissuereg.meshing.settings import MESHING
from tissuereg.meshing.topology import Edges
from tissuereg.meshing.words import place, several, were


def closed(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Return the surface with its holes closed, and sentences that state the repairs.

    Neighbouring triangles must agree in their winding. The triangles that close holes come after the existing ones. A
    large hole gets a fan of triangles about its centre, and these centres come after the existing vertices.

    >>> cap = closed(Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 2, 1], [0, 1, 3], [0, 3, 2]]))
    >>> cap[0].triangles[3].tolist(), round(cap[0].volume, 1)
    ([1, 2, 3], 121.5)
    >>> cap[1]
    ['1 hole was closed: the largest has a rim of 3 edges about (3, 3, 3) mm; caps make up 36.6 % of the surface']
    """
    surface, repairs = _without_loose(surface)
    rims = _rims(surface.triangles)
    if not rims:
        return surface, repairs
    edges = np.sort(Edges.of(surface.triangles).ends, axis=1)
    taken = {(first, second) for first, second in edges[np.isin(edges, np.concatenate(rims)).all(axis=1)].tolist()}
    vertices, caps = surface.vertices, []
    for rim in rims:
        if len(rim) <= MESHING.longest_table:
            barred = [[(min(a, b), max(a, b)) in taken for b in rim.tolist()] for a in rim.tolist()]
            caps.append(rim[least_area_cap(surface.vertices[rim], np.array(barred))])
            taken.update((a, b) for a, b in np.sort(Edges.of(caps[-1]).ends, axis=1).tolist())
        else:
            middle = np.full(len(rim), len(vertices))
            vertices = np.concatenate([vertices, surface.vertices[rim].mean(axis=0, keepdims=True)])
            caps.append(np.stack([rim, np.roll(rim, -1), middle], axis=1))
    whole = Triangles(vertices, np.concatenate([surface.triangles, *caps]))
    size = [float(triangle_areas(vertices[cap]).sum()) for cap in caps]
    largest = int(np.argmax(size))
    share = 100.0 * sum(size) / float(whole.areas.sum())
    n, rim = len(rims), rims[largest]
    repairs.append(
        f"{several(n, 'hole')} {were(n)} closed: the largest has a rim of {len(rim)} edges about "
        f"{place(surface.vertices[rim].mean(axis=0))}; caps make up {share:.3g} % of the surface"
    )
    return whole, repairs


def least_area_cap(corners: FloatArray, barred: BoolArray | None = None) -> IntArray:
    """Return the n - 2 triangles of least total area that close a polygon in space, in its sense of rotation.

    `corners` (n, 3): vertices of the polygon in order, mm; the triangles (n - 2, 3) are indices into them. `barred` (n,
    n) marks the pairs of corners that an edge of the surface joins already: the cap gets another edge between such a
    pair only if no cap does without.

    Example: in a square with one corner pulled in, the common edge of the two triangles ends at that corner.

    >>> least_area_cap(np.array([[0.0, 0, 0], [9, 0, 0], [3, 3, 0], [0, 9, 0]])).tolist()
    [[0, 2, 3], [0, 1, 2]]
    """
    n = len(corners)
    least, via = np.zeros((n, n)), np.zeros((n, n), np.int64)
    # More than the area of any cap: its corners lie within the rim's length of each other.
    price = n * float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum()) ** 2
    prices = np.zeros((n, n)) if barred is None else price * barred
    prices[0, -1] = 0.0
    for length in range(2, n):
        i = np.arange(n - length)[:, None]
        j, k = i + length, i + np.arange(1, length)
        three = np.stack(np.broadcast_arrays(corners[i], corners[k], corners[j]), axis=-2)
        cost = least[i, k] + least[k, j] + triangle_areas(three)
        best = np.argmin(cost, axis=1)
        rows = np.arange(n - length)
        least[rows, rows + length] = cost[rows, best] + prices[rows, rows + length]
        via[rows, rows + length] = rows + 1 + best
    found, open_ = [], [(0, n - 1)]
    while open_:
        start, end = open_.pop()
        if end - start > 1:
            cut = int(via[start, end])
            found.append((start, cut, end))
            open_ += [(start, cut), (cut, end)]
    return np.array(found, np.int64).reshape(-1, 3)


def _without_loose(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Return the surface without triangles that share no edge with another, and sentences that state the removal."""
    edges = Edges.of(surface.triangles)
    loose = (edges.count[edges.group].reshape(-1, 3) == 1).all(axis=1)
    n = int(loose.sum())
    if not n or loose.all():
        return surface, []
    repairs = f"{several(n, 'triangle')} that shared no edge with another {were(n)} left out"
    return Triangles(surface.vertices, surface.triangles[~loose]), [repairs]


def _rims(triangles: IntArray) -> list[IntArray]:
    """Return each hole's rim as vertex indices, in its cap's sense of rotation; open chains of edges are ignored."""
    edges = Edges.of(triangles)
    onward: dict[int, list[int]] = {}
    for start, end in edges.ends[edges.count[edges.group] == 1].tolist():
        onward.setdefault(end, []).append(start)
    rims: list[IntArray] = []
    for first in list(onward):
        while onward[first]:
            path, seen = [first], {first: 0}
            while onward.get(path[-1]):
                after = onward[path[-1]].pop()
                if after in seen:  # a rim that passes a vertex twice is two rims
                    rims.append(np.array(path[seen[after] :], np.int64))
                    for left in path[seen[after] + 1 :]:
                        del seen[left]
                    del path[seen[after] + 1 :]
                else:
                    seen[after] = len(path)
                    path.append(after)
    return [rim for rim in rims if len(rim) > 2]
