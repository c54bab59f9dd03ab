"""The surface of a body as it is drawn: few enough triangles, each with the number of its patch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh


class Fineness(NamedTuple):
    """How finely bodies are drawn: numbers of triangles and of nodes of a set at most; first grid, and its growth."""

    triangles: int = 12_000
    nodes: int = 1500
    cells: float = 80.0
    growth: float = 1.25


FINENESS = Fineness()


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """The triangles of a surface, each with the number of its patch.

    `nodes` (n, 3): mm; `triangles` int64 (m, 3): with outward normals; `patch` int64 (m,): 0 is the free surface;
    `source` (n_source,): nodes of the body's surface; `group` (n_source,): the drawn node to which each belongs;
    `whole`: number of triangles of the body's surface.
    """

    nodes: FloatArray
    triangles: IntArray
    patch: IntArray
    source: IntArray
    group: IntArray
    whole: int = field(default=0)

    @classmethod
    def of(cls, mesh: Mesh, patches: Sequence[IntArray] = (), most: int = FINENESS.triangles) -> "DrawnBody":
        """Return the surface of a mesh, coarse enough to be drawn.

        `patches`: nodes of patches 1, 2 ..., of which a triangle has all three corners, later ones win; `most`:
        number of triangles at most. Nodes are merged on coarser and coarser grids until there are few enough triangles.
        """
        patch = np.zeros(len(mesh.surface), np.int64)
        for number, nodes in enumerate(patches, 1):
            patch[np.isin(mesh.surface, nodes).all(axis=1)] = number
        used, triangles = np.unique(mesh.surface, return_inverse=True)
        group = np.arange(len(used))
        found = cls(mesh.nodes[used], triangles.reshape(-1, 3), patch, used, group, len(triangles.reshape(-1, 3)))
        width = mesh.extent / FINENESS.cells
        while len(found.triangles) > most:
            found = found._joined(width)
            width *= FINENESS.growth
        return found

    def field(self, values: FloatArray) -> FloatArray:
        """Return values of all nodes of the body (n_nodes, ...) at the drawn nodes, means where some are merged."""
        given = values[self.source]
        if len(self.nodes) == len(self.source):
            return np.asarray(given)
        flat = given.reshape(len(given), -1)
        count = np.bincount(self.group)
        sums = [np.bincount(self.group, column) / count for column in flat.T]
        return np.stack(sums, axis=1).reshape(len(count), *given.shape[1:])

    @property
    def words(self) -> str:
        """Return a sentence on the drawn surface if it is coarser than the body's, else an empty text."""
        if len(self.triangles) == self.whole:
            return ""
        return f"The surface of {self.whole:,} triangles is drawn by {len(self.triangles):,}."

    def _joined(self, width: float) -> "DrawnBody":
        """Return the surface with all nodes in a grid cell, a cube of edge `width` mm, replaced by their mean."""
        cells = np.floor((self.nodes - self.nodes.min(axis=0)) / width).astype(np.int64)
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        triangles = cell[self.triangles]
        whole = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
        group = cell[self.group]
        weight = np.bincount(self.group).astype(np.float64)
        total = np.bincount(cell, weight)
        nodes = np.stack([np.bincount(cell, weight * self.nodes[:, axis]) / total for axis in range(3)], axis=1)
        return DrawnBody(nodes, triangles[whole], self.patch[whole], self.source, group, self.whole)


__all__ = ["FINENESS", "DrawnBody", "Fineness"]
