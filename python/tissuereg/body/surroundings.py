"""A displacement field around a body: the body's own inside, and outside one that fades smoothly to nothing.

The space around is cut into tetrahedra between the nodes of the skin and a lattice of points. Out there every component
of the displacement is harmonic: it equals that of the skin at the skin, is hardly anywhere larger, and is zero at a
distance of half the body's extent. The field is linear in each tetrahedron, of the body or around it, and so is its
inverse.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.locate import Locator, held_by, surface_of
from tissuereg.body.mesh import Mesh, per_mesh


@dataclass(frozen=True)
class _Around:
    """How finely space around a body is cut, in shares of its extent, and where the displacement ends."""

    margin: float = 0.5
    spacing: float = 1.0 / 14.0
    clearance: float = 0.4  # of the spacing: no point of the lattice is closer to the skin
    jitter: float = 0.1  # of the spacing: points that lie on one sphere are cut badly


class Surroundings:
    """Space around the body of a mesh, cut into tetrahedra; made once for a mesh. `mesh`: the body."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import Delaunay

        how = _Around()
        # Middles of edges as well, so that tets outside meet the triangles of the skin as they are.
        edges = np.sort(
            np.concatenate([mesh.surface[:, [0, 1]], mesh.surface[:, [1, 2]], mesh.surface[:, [2, 0]]]), axis=1
        )
        single = np.repeat(mesh.surface_nodes[:, None], 2, axis=1)
        self.mesh, self.skin = mesh, np.concatenate([single, np.unique(edges, axis=0)])
        spacing = how.spacing * mesh.extent
        low, high = mesh.nodes.min(axis=0) - how.margin * mesh.extent, mesh.nodes.max(axis=0) + how.margin * mesh.extent
        counts = np.ceil((high - low) / spacing).astype(int) + 1
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self._ends = np.any((lattice == low) | (lattice == high), axis=1)
        rng = np.random.default_rng(0)
        lattice[~self._ends] += how.jitter * spacing * rng.uniform(-1.0, 1.0, (int((~self._ends).sum()), 3))
        found = surface_of(mesh).find(lattice)
        corners = mesh.nodes[mesh.surface[found.triangles]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outside = np.einsum("nx,nx->n", lattice - found.feet, normals) > 0.0
        kept = self._ends | (outside & (found.distances > how.clearance * spacing))
        self.lattice, self._ends = lattice[kept], self._ends[kept]
        self.cut: Any = Delaunay(np.concatenate([self.on_skin(mesh.nodes), self.lattice]))

    def on_skin(self, values: FloatArray) -> FloatArray:
        """Return values of the body's nodes (n_nodes, 3) at the points of the skin, nodes and middles of edges."""
        return np.asarray(values[self.skin].mean(axis=1))

    @property
    def tets(self) -> IntArray:
        """Tetrahedra int64 (m, 4) between points of the skin and of the lattice, numbered in this order."""
        return np.asarray(self.cut.simplices, np.int64)

    @cached_property
    def _harmonic(self) -> tuple[Any, Any]:
        """Factor of the Laplacian of the lattice's free points, and its part that couples them to the skin."""
        from scipy.sparse import coo_array
        from scipy.sparse.linalg import splu

        places, tets = self.cut.points, self.tets
        edges = places[tets[:, 1:]] - places[tets[:, :1]]
        volumes = np.abs(np.linalg.det(edges))
        # Slivers on the flat faces of the box couple nothing.
        sound = volumes > 1e-9 * volumes.max()
        slopes = np.moveaxis(np.linalg.inv(edges[sound]), 1, 2)
        slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
        blocks = np.einsum("tax,tbx,t->tab", slopes, slopes, volumes[sound])
        rows, columns = np.repeat(tets[sound], 4, axis=1), np.tile(tets[sound], (1, 4))
        n = len(places)
        whole = coo_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)).tocsr()
        free = len(self.skin) + np.flatnonzero(~self._ends)
        return splu(whole[free][:, free].tocsc()), whole[free][:, : len(self.skin)]

    def extended(self, field: FloatArray) -> FloatArray:
        """Return a field of the body's nodes (n_nodes, 3), mm, at the lattice's points, (n_points, 3), mm."""
        factor, coupling = self._harmonic
        found = np.zeros_like(self.lattice)
        found[~self._ends] = factor.solve(-(coupling @ self.on_skin(field)))
        return np.asarray(found)


surroundings = per_mesh(Surroundings)


@dataclass(frozen=True, eq=False)
class SpaceMap:
    """A displacement of space: that of a body's nodes inside the body, extended around it.

    Attributes
    ----------
    mesh : Mesh
        The undeformed body.
    displacement : ndarray of float64, shape (n_nodes, 3)
        Of its nodes, mm.
    """

    mesh: Mesh
    displacement: FloatArray

    @cached_property
    def _around(self) -> FloatArray:
        around = surroundings(self.mesh)
        return np.concatenate([around.on_skin(self.displacement), around.extended(self.displacement)])

    def cells(self) -> tuple[FloatArray, FloatArray, IntArray, int]:
        """Return nodes (n, 3) and their displacement (n, 3), mm, tets int64 (m, 4), and the number of the first inner.

        The tets before that number are around the body; they reach into it a little where it is curved.
        """
        around, n_nodes = surroundings(self.mesh), self.mesh.n_nodes
        nodes = np.concatenate([self.mesh.nodes, around.cut.points])
        moved = np.concatenate([self.displacement, self._around])
        return nodes, moved, np.concatenate([n_nodes + around.tets, self.mesh.tets]), len(around.tets)

    def at(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the displacement of points (n, 3), mm, and whether each is inside the body, (n,)."""
        return self.of(points, held_by(self.mesh, points))

    def of(self, points: FloatArray, held: tuple[IntArray, FloatArray, BoolArray]) -> tuple[FloatArray, BoolArray]:
        """Return the same of points of which `held_by` has told where they are."""
        nodes, weights, inside = held
        moved = np.einsum("pk,pkx->px", weights, self.displacement[nodes])
        if not inside.all():
            moved[~inside] = self._outside(points[~inside])
        return moved, inside

    def _outside(self, points: FloatArray) -> FloatArray:
        around = surroundings(self.mesh)
        simplex = around.cut.find_simplex(points)
        at = around.cut.transform[simplex]
        shares = np.einsum("pij,pj->pi", at[:, :3], points - at[:, 3])
        shares = np.concatenate([shares, 1.0 - shares.sum(axis=1, keepdims=True)], axis=1)
        moved = np.einsum("pk,pkx->px", shares, self._around[around.cut.simplices[simplex]])
        # Beyond the lattice, and in tetrahedra without a volume, where there are no shares.
        return np.where((simplex[:, None] >= 0) & np.isfinite(moved), moved, 0.0)

    @cached_property
    def _deformed(self) -> tuple[FloatArray, list[tuple[Locator, IntArray]]]:
        """Displacement of all nodes; search structures of the deformed tets, the body's first, with their corners."""
        nodes, moved, tets, inner = self.cells()
        places = nodes + moved
        edges = places[tets[:, 1:]] - places[tets[:, :1]]
        volumes = np.abs(np.linalg.det(edges))
        sound = volumes > 1e-9 * volumes.max()
        parts = [tets[inner:][sound[inner:]], tets[:inner][sound[:inner]]]
        return moved, [(Locator(places, part), part) for part in parts]

    def back(self, points: FloatArray) -> FloatArray:
        """Return the displacement (n, 3), mm, of places that moved to points (n, 3), mm: zero beyond the lattice."""
        moved, parts = self._deformed
        found = np.zeros_like(points)
        left = np.arange(len(points))
        for locator, tets in parts:
            cells = locator.inside(points[left])
            held = np.array([cell is not None for cell in cells], dtype=bool)
            for i, cell in zip(left, cells, strict=True):
                if cell is not None:
                    found[i] = cell[1] @ moved[tets[cell[0]]]
            left = left[~held]
        return found


__all__ = ["SpaceMap", "Surroundings", "surroundings"]
