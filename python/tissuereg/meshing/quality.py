"""Quality of tetrahedra, and their distance from the surface that they fill."""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.body.triangles import Triangles
from tissuereg.meshing.settings import MESHING
from tissuereg.simulation.fine.bisection import shape_quality


def quality(mesh: Mesh, surface: Triangles) -> dict[str, Any]:
    """Return quality measures of a mesh that fills a surface.

    `mesh`: tetrahedra; `surface`: the surface that they fill, closed, normals outward. Result: ``min_quality``,
    ``median_quality`` (mean ratio, 1 where regular), ``shortest_edge_mm``, ``median_edge_mm``, ``surface_distance_mm``
    (largest distance of the tets' boundary from the surface, at its nodes and the middles of its triangles),
    ``missed_mm`` (the same from the surface to the tets' boundary: thin parts that were lost, and inner shells),
    ``volume_mm3``, ``volume_change_percent`` (against what the surface encloses), ``parts`` (that share no node).

    Notes
    -----
    Cost: one search for the closest triangle per point, at most `MESHING.points` each way.
    """
    shape = shape_quality(mesh.nodes, mesh.tets)
    length = np.linalg.norm(mesh.nodes[mesh.edges[:, 0]] - mesh.nodes[mesh.edges[:, 1]], axis=1)
    boundary = Triangles(mesh.nodes, mesh.surface)
    volume = float(mesh.volumes.sum())
    return {
        "min_quality": float(shape.min()),
        "median_quality": float(np.median(shape)),
        "shortest_edge_mm": float(length.min()),
        "median_edge_mm": float(np.median(length)),
        "surface_distance_mm": largest_distance(boundary, surface),
        "missed_mm": largest_distance(surface, boundary),
        "volume_mm3": volume,
        "volume_change_percent": 100.0 * (volume / surface.volume - 1.0),
        "parts": _parts(mesh),
    }


def largest_distance(measured: Triangles, to: Triangles) -> float:
    """Return the largest distance of corners and middles of triangles from another surface, mm.

    Examples
    --------
    >>> flat = Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]])
    >>> largest_distance(Triangles([[0, 0, 2], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]]), flat)
    2.0
    """
    import trimesh

    proximity: Any = trimesh.proximity  # trimesh leaves these functions without annotations
    target = trimesh.Trimesh(to.vertices, to.triangles, process=False)
    _, distance, _ = proximity.closest_point(target, _points(measured))
    return float(np.max(distance))


def _points(surface: Triangles) -> FloatArray:
    points = np.concatenate([surface.vertices[np.unique(surface.triangles)], surface.corners.mean(axis=1)])
    return np.asarray(points[:: -(-len(points) // MESHING.points)])


def _parts(mesh: Mesh) -> int:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array(
        (np.ones(len(mesh.edges), np.int8), (mesh.edges[:, 0], mesh.edges[:, 1])), shape=(mesh.n_nodes,) * 2
    )
    return int(connected_components(graph, directed=False)[0])
