"""Merges vertices at the same place; removes triangles without an area and duplicates."""

import numpy as np

from tissuereg._base.arrays import IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshError
from tissuereg.meshing.settings import MESHING
from tissuereg.meshing.words import several, were


def joined(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Return the surface with every vertex and every triangle once.

    Result: the remaining vertices and triangles keep their order. list of str The repairs, one sentence each. Raises
    `MeshError` if no triangle is left.

    Examples
    --------
    >>> joined(Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 9, 0]], [[0, 1, 2], [0, 1, 3]]))
    (Triangles(3 vertices, 1 triangles), ['1 vertex that stood at the place of another was merged with it',
    '1 triangle given a second time was left out'])
    """
    repairs = []
    used = np.unique(surface.triangles)
    one = _first_of_place(surface, used)
    merged = int(np.count_nonzero(one[used] != used))
    if merged:
        repairs.append(
            f"{several(merged, 'vertex', 'vertices')} that stood at the place of another {were(merged)} merged with it"
        )
    triangles = one[surface.triangles]
    flat = (np.diff(np.sort(triangles, axis=1), axis=1) == 0).any(axis=1)
    flat |= surface.areas <= (MESHING.same_place * surface.extent) ** 2
    if flat.any():
        n = int(flat.sum())
        repairs.append(f"{several(n, 'triangle')} without an area {were(n)} left out")
        triangles = triangles[~flat]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    if len(first) < len(triangles):
        n = len(triangles) - len(first)
        repairs.append(f"{several(n, 'triangle')} given a second time {were(n)} left out")
        triangles = triangles[np.sort(first)]
    if not len(triangles):
        message = f"a surface must have triangles with an area; none of {len(surface.triangles)} has one"
        raise MeshError(message, where="surface")
    kept, corners = np.unique(triangles, return_inverse=True)
    return Triangles(surface.vertices[kept], corners.reshape(-1, 3)), repairs


def _first_of_place(surface: Triangles, used: IntArray) -> IntArray:
    """Return, for every vertex, the lowest used vertex at its place."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    places = surface.vertices[used]
    pairs = KDTree(places).query_pairs(MESHING.same_place * surface.extent, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    group = connected_components(graph, directed=False)[1]
    _, lowest = np.unique(group, return_index=True)
    one = np.arange(len(surface.vertices))
    one[used] = used[lowest[group]]
    return np.asarray(one, np.int64)
