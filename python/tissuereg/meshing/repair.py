"""Repairs a segmented surface so that it encloses a body, and reports every repair."""

import numpy as np

from tissuereg.body.triangles import Triangles
from tissuereg.meshing.crossings import crossing_pairs
from tissuereg.meshing.holes import closed
from tissuereg.meshing.join import joined
from tissuereg.meshing.shells import outward
from tissuereg.meshing.topology import Edges, agreed_winding, turned_round
from tissuereg.meshing.words import place, several, were


def repaired(surface: Triangles, least_volume: float) -> tuple[Triangles, list[str]]:
    """Return a repaired surface, with the repairs and remaining defects.

    In this order: vertices at one place are merged, triangles without an area and duplicates are removed, neighbours
    are made to agree in their winding, holes are closed, normals are turned outwards, tiny shells are removed; then
    crossing triangles are counted. `least_volume`: closed shells of less volume are removed, except the largest, mm^3.
    Result: normals outward. list of str One sentence each; empty if there was nothing to repair. Raises `MeshError` if
    no triangle has an area, a shell has one side only, or nothing is enclosed.

    Examples
    --------
    A tetrahedron without one of its faces, its normals inwards:

    >>> open_ = Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2], [0, 3, 1], [0, 2, 3]])
    >>> body, repairs = repaired(open_, 1.0)
    >>> round(body.volume, 1)
    121.5
    >>> [sentence[:29] for sentence in repairs]
    ['1 hole was closed: the larges', 'all normals pointed inwards a']
    """
    surface, repairs = joined(surface)
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


def _left(surface: Triangles) -> list[str]:
    """Return sentences on the remaining defects."""
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
