"""Where points lie in a body: the tetrahedron around each, and its barycentric weights."""

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.closest import ClosestTriangles, barycentric
from tissuereg.body.mesh import Mesh, per_mesh

#: A tet by number, and the barycentric weights (4,) of a point in it.
Cell = tuple[int, FloatArray]


class Locator:
    """Search structure for the tet that contains a point: boxes of all tets sorted along x, inverses for weights.

    `nodes` (n, 3): mm; `tets` int64 (m, 4): tets of any orientation, none of them flat.
    """

    def __init__(self, nodes: FloatArray, tets: IntArray) -> None:
        self._corners = nodes[tets]
        self.extent = float(np.ptp(nodes, axis=0).max())
        self._lowest, self._highest = self._corners.min(axis=1), self._corners.max(axis=1)
        # Along x, a tet that contains a point begins at most the widest one's width before it.
        self._by_x = np.argsort(self._lowest[:, 0], kind="stable")
        self._begins = self._lowest[self._by_x, 0]
        self._widest = float((self._highest[:, 0] - self._lowest[:, 0]).max())
        self._inverse = np.linalg.inv(np.moveaxis(self._corners[:, 1:] - self._corners[:, :1], 1, 2))

    def inside(self, points: FloatArray) -> list[Cell | None]:
        """Return the tet around each of points (n, 3), mm, with weights; None for those outside or not finite.

        Where there are many points they are first looked for among the tets nearby.
        """
        # Outside the box of the body, or not a place at all.
        near = 1e-6 * self.extent
        low, high = self._lowest.min(axis=0) - near, self._highest.max(axis=0) + near
        possible = np.asarray(((points >= low) & (points <= high)).all(axis=1))
        found = self._nearby(points, np.flatnonzero(possible))
        return [found.get(i) or (self.around(point) if possible[i] else None) for i, point in enumerate(points)]

    def _nearby(self, points: FloatArray, asked: IntArray) -> dict[int, Cell]:
        """Return the cells of those of the points (n, 3), by number, that are clearly in a tet nearby; few are not."""
        nearby, block = min(16, len(self._corners)), 20_000
        found: dict[int, Cell] = {}
        if not len(asked) > nearby > 1:
            return found
        from scipy.spatial import KDTree

        middles = KDTree(self._corners.mean(axis=1))
        for some in (asked[first : first + block] for first in range(0, len(asked), block)):
            tets = np.asarray(middles.query(points[some], nearby)[1])
            inner = np.einsum("ptij,ptj->pti", self._inverse[tets], points[some, None] - self._corners[tets, 0])
            weights = np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)
            least = weights.min(axis=2)
            best = least.argmax(axis=1)
            for i in np.flatnonzero(least.max(axis=1) > 1e-9):
                found[int(some[i])] = int(tets[i, best[i]]), weights[i, best[i]]
        return found

    def around(self, point: FloatArray) -> Cell | None:
        """Return the tet around a point (3,), mm, with its weights; None if it is outside."""
        near = 1e-6 * self.extent
        first, last = np.searchsorted(self._begins, (point[0] - self._widest - 2.0 * near, point[0] + 2.0 * near))
        tets = np.sort(self._by_x[first:last])
        lowest, highest = self._lowest[tets] - near, self._highest[tets] + near
        tets = tets[((point >= lowest) & (point <= highest)).all(axis=1)]
        weights = self._weights(tets, point)
        if len(tets) and weights.min(axis=1).max() >= -1e-9:
            best = int(np.argmax(weights.min(axis=1)))
            return int(tets[best]), weights[best]
        return None

    def closest(self, point: FloatArray) -> tuple[int, FloatArray, float]:
        """Return the tet closest to a point (3,), mm, its weights, some negative, and about how far it is, mm."""
        weights = self._weights(np.arange(len(self._corners)), point)
        clipped = np.clip(weights, 0.0, None)
        clipped /= clipped.sum(axis=1, keepdims=True)
        gap = np.linalg.norm(np.einsum("tc,tcx->tx", clipped, self._corners) - point, axis=1)
        tet = int(np.argmin(gap))
        return tet, weights[tet], float(gap[tet])

    def _weights(self, tets: IntArray, point: FloatArray) -> FloatArray:
        """Return the barycentric weights (n, 4) of a point (3,), in mm, in the tets with indices `tets` (n,)."""
        inner = np.einsum("tij,tj->ti", self._inverse[tets], point - self._corners[tets, 0])
        return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)


def _located_in(mesh: Mesh) -> Locator:
    return Locator(mesh.nodes, mesh.tets)


def _surface_of(mesh: Mesh) -> ClosestTriangles:
    return ClosestTriangles(mesh.nodes[mesh.surface])


#: Search structures of a mesh, made once.
located_in = per_mesh(_located_in)
surface_of = per_mesh(_surface_of)


def held_by(mesh: Mesh, points: FloatArray) -> tuple[IntArray, FloatArray, BoolArray]:
    """Return the nodes int64 (n, 4) and weights (n, 4) of points (n, 3), mm, and whether each is inside the body.

    A point outside has those of the closest place of the skin, with a fourth weight of zero.
    """
    found = located_in(mesh).inside(points)
    inside = np.array([one is not None for one in found], dtype=bool)
    nodes, weights = np.zeros((len(points), 4), np.int64), np.zeros((len(points), 4))
    for i, one in enumerate(found):
        if one is not None:
            nodes[i], weights[i] = mesh.tets[one[0]], one[1]
    out = np.flatnonzero(~inside)
    if len(out):
        near = surface_of(mesh).find(points[out])
        triangles = mesh.surface[near.triangles]
        nodes[out] = np.concatenate([triangles, triangles[:, :1]], axis=1)
        weights[out, :3] = np.clip(barycentric(near.feet, mesh.nodes[triangles]), 0.0, None)
        weights[out] /= weights[out].sum(axis=1, keepdims=True)
    return nodes, weights, inside


__all__ = ["Locator", "held_by", "located_in", "surface_of"]
