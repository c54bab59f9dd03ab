"""Edges of a surface and the two facets that meet at each."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.simulation.settings import FINE


@dataclass(frozen=True, eq=False)
class Folds:
    """Edges of a closed surface of triangles.

    Attributes
    ----------
    edges : ndarray of int64, shape (n_edges, 2)
        Nodes, ascending.
    facets : ndarray of int64, shape (n_edges, 2)
        Numbers of the triangles at each.
    cosines : ndarray of float64, shape (n_edges,)
        Of the angles between their normals.
    normals : ndarray of float64, shape (n_triangles, 3)
        Unit normals of all triangles, as their corners turn.
    areas : ndarray of float64, shape (n_triangles,)
        Of all triangles, mm^2.
    """

    edges: IntArray
    facets: IntArray
    cosines: FloatArray
    normals: FloatArray
    areas: FloatArray

    @property
    def is_sharp(self) -> np.ndarray:
        """Whether each is an edge of the body, rather than one of facets along a smooth face, shape (n_edges,)."""
        return np.asarray(self.cosines < FINE.sharp)


def folds_of(nodes: FloatArray, surface: IntArray) -> Folds:
    """Return the edges of a closed surface.

    Parameters
    ----------
    nodes : ndarray of float64, shape (n_nodes, 3)
        mm.
    surface : ndarray of int64, shape (n_triangles, 3)
        Triangles, two at every edge.

    Returns
    -------
    Folds
        Edges in ascending order of their nodes.
    """
    corners = nodes[surface]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / lengths[:, None]
    sides = np.sort(surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs = np.lexsort((sides[:, 1], sides[:, 0])).reshape(-1, 2)
    facets = pairs // 3
    cosines = np.clip((normals[facets[:, 0]] * normals[facets[:, 1]]).sum(axis=1), -1.0, 1.0)
    return Folds(sides[pairs[:, 0]], facets, cosines, normals, 0.5 * lengths)
