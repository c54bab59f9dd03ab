"""Edges of a surface and the two facets that meet at each."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.simulation.settings import FINE


@dataclass(frozen=True, eq=False)
class Folds:
    """Edges of a closed surface of triangles.

    `edges` int64 (n_edges, 2): nodes, ascending; `facets` int64 (n_edges, 2): numbers of the triangles at each;
    `cosines` (n_edges,): of the angles between their normals; `normals` (n_triangles, 3): unit normals of all
    triangles, as their corners turn; `areas` (n_triangles,): of all triangles, mm^2.
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

    `nodes` (n_nodes, 3): mm; `surface` int64 (n_triangles, 3): triangles, two at every edge. Result: edges in ascending
    order of their nodes.
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
