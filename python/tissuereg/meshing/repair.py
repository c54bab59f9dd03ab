"""Repair of a segmented surface so that it encloses a body, with a report of every repair."""

import numpy as np

from tissuereg._base.arrays import IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshError
from tissuereg.meshing.crossings import crossing_pairs
from tissuereg.meshing.holes import closed
from tissuereg.meshing.settings import MESHING
from tissuereg.meshing.shells import outward
from tissuereg.meshing.topology import Edges, agreed_winding, components, turned_round
from tissuereg.meshing.words import place, several, were


def repaired(surface: Triangles, least_volume: float) -> tuple[Triangles, list[str]]:
    """Return the repaired surface, its normals outwards, and one sentence for each repair and each remaining defect.

    In this order: vertices at one place are merged, triangles without an area and duplicates are removed, neighbours
    are made to agree in their winding, holes are closed, normals are turned outwards, closed shells of less than
    `least_volume` mm^3 are removed, except the largest; then crossing triangles are counted. Raises MeshError if no
    triangle has an area, a shell has one side only, or nothing is enclosed.

    Example: a tetrahedron that lacks one of its faces and whose normals point inwards.

    >>> open_ = Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2], [0, 3, 1], [0, 2, 3]])
    >>> body, repairs = repaired(open_, 1.0)
    >>> round(body.volume, 1)
    121.5
    >>> [sentence[:29] for sentence in repairs]
    ['1 hole was closed: the larges', 'all normals pointed inwards a']
    """
    surface, repairs = _joined(surface)
    turned, _ = agreed_winding(surface)
    if len(turned):
        surface = Triangles(surface.vertices, turned_round(surface.triangles, turned))
        repairs.append(
            f"{several(len(turned), 'triangle')} facing the other way than their neighbours {were(len(turned))} turned"
        )
    surface, filled = closed(surface)
    _, shell = agreed_winding(surface)
    found, sided = outward(surface, shell, least_volume)
    return found, [*repairs, *filled, *sided, *_left(found)]


def _joined(surface: Triangles) -> tuple[Triangles, list[str]]:
    """Return the surface without duplicate vertices and triangles, in the given order, and a sentence for each repair.

    Triangles without an area are removed as well. Raises MeshError if no triangle is left.

    >>> _joined(Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 9, 0]], [[0, 1, 2], [0, 1, 3]]))
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
    """Return for each vertex the lowest index of a vertex of `used` (indices) at the same place, (n_vertices,)."""
    from scipy.spatial import KDTree

    places = surface.vertices[used]
    pairs = KDTree(places).query_pairs(MESHING.same_place * surface.extent, output_type="ndarray")
    group = components(pairs[:, 0], pairs[:, 1], len(used))
    _, lowest = np.unique(group, return_index=True)
    one = np.arange(len(surface.vertices))
    one[used] = used[lowest[group]]
    return np.asarray(one, np.int64)


def _left(surface: Triangles) -> list[str]:
    """Return sentences on the defects that repair has left: edges of several walls, open rims, crossing triangles."""
    defects = []
    edges = Edges.of(surface.triangles)
    walls, rim = int(np.count_nonzero(edges.count > 2)), int(np.count_nonzero(edges.count == 1))
    if walls:
        defects.append(
            f"{several(walls, 'edge')} of more than two triangles (inner walls, shells that touch) {were(walls)} left"
        )
    if rim:
        defects.append(f"{several(rim, 'edge')} at the rim of a hole could not be closed and {were(rim)} left")
    crossing = crossing_pairs(surface)
    if crossing is None:
        defects.append("whether triangles cross each other was not checked: there are too many")
    elif len(crossing):
        where = place(surface.corners[crossing[0, 0]].mean(axis=0))
        defects.append(
            f"{several(len(crossing), 'pair')} of triangles cross each other, one about {where}: what either side "
            "encloses was filled"
        )
    return defects
