"""Closest places of triangles, and the exact search for the triangle of a surface that is closest to a point."""

from typing import Any, NamedTuple

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray

#: Distances that differ by less than this share of the surface's extent are equal: a corner is on several triangles.
_SAME = 1e-10

#: Points for which triangles are tested at a time: what fits a small machine, also where all triangles must be.
_BLOCK = 256


class Closest(NamedTuple):
    """Closest places of a surface to points: triangles, int64 (n,); feet (n, 3) on them, mm; distances (n,), mm."""

    triangles: IntArray
    feet: FloatArray
    distances: FloatArray


class ClosestTriangles:
    """Search for the closest of many triangles, whatever their sizes, exact for points at any distance.

    `corners` (m, 3, 3): corners of the triangles, mm. Each triangle lies in a ball about its centroid. A triangle can
    be closest only if its ball reaches as near as the triangle of the closest centroid does. Balls are searched in
    groups of like radius, so that a few large ones do not make all the small ones candidates.
    """

    def __init__(self, corners: FloatArray) -> None:
        from scipy.spatial import KDTree

        self._corners = corners
        self._same = _SAME * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        self._centres = corners.mean(axis=1)
        self._radii = np.linalg.norm(corners - self._centres[:, None], axis=2).max(axis=1)
        size = np.frexp(self._radii)[1]
        groups = [np.flatnonzero(size == one) for one in np.unique(size)]
        self._groups: list[tuple[IntArray, float, Any]] = [
            (rows, float(self._radii[rows].max()), KDTree(self._centres[rows])) for rows in groups
        ]
        self._tree = KDTree(self._centres)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(float).tiny)

    def find(self, points: FloatArray) -> Closest:
        """Return the closest place of the triangles to each of the points (n, 3), mm.

        Of triangles that share the closest place, an edge or a corner, that one is returned which faces the point most;
        of those that do so equally, the first.
        """
        parts = [self._find(points[begin : begin + _BLOCK]) for begin in range(0, len(points), _BLOCK)]
        none = Closest(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))
        return Closest(*(np.concatenate(several) for several in zip(none, *parts, strict=True)))

    def _find(self, points: FloatArray) -> Closest:
        rows, triangles = self._candidates(points)
        feet = closest_on_triangles(points[rows], self._corners[triangles])
        off = points[rows] - feet
        gaps = np.linalg.norm(off, axis=1)
        least = np.full(len(points), np.inf)
        np.minimum.at(least, rows, gaps)
        facing = np.abs(np.einsum("nx,nx->n", self._normals[triangles], off))
        facing[gaps > least[rows] + self._same] = -1.0
        # By point, then the most facing, of which that counts as equal which differs by rounding, then by number.
        most = np.full(len(points), -1.0)
        np.maximum.at(most, rows, facing)
        order = np.lexsort((triangles, facing < most[rows] - self._same, rows))
        best = order[np.searchsorted(rows[order], np.arange(len(points)))]
        return Closest(triangles[best], feet[best], gaps[best])

    def _candidates(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return numbers of points and of the triangles that may be closest to them, two equally long arrays."""
        first = np.asarray(self._tree.query(points)[1], np.int64)
        reach = np.linalg.norm(points - closest_on_triangles(points, self._corners[first]), axis=1) + self._same
        rows, triangles = [np.arange(len(points))], [first]
        for numbers, radius, tree in self._groups:
            lists = tree.query_ball_point(points, reach + radius)
            rows.append(np.repeat(np.arange(len(points)), [len(one) for one in lists]))
            triangles.append(numbers[np.concatenate(lists).astype(np.int64)])
        row, triangle = np.concatenate(rows), np.concatenate(triangles)
        near = np.linalg.norm(points[row] - self._centres[triangle], axis=1) <= reach[row] + self._radii[triangle]
        near[: len(points)] = True
        return row[near], triangle[near]


def barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the weights (..., 3) of the corners of triangles at points (..., 3), projected onto their planes.

    `corners` (..., 3, 3), mm. The weights of a triangle without an area are 1, 0, 0.
    """
    second, third, _ = _shares(points, corners)
    return np.stack([1.0 - second - third, second, third], axis=-1)


def closest_on_triangles(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the closest points (..., 3), mm, of triangles with corners (..., 3, 3), mm, to points (..., 3), mm."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    second, third, flat = _shares(points, corners)
    within = (second >= 0.0) & (third >= 0.0) & (second + third <= 1.0) & ~flat
    best = a + second[..., None] * (b - a) + third[..., None] * (c - a)
    gap = np.where(within, 0.0, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        length = np.maximum(np.einsum("...x,...x->...", along, along), 1e-300)
        share = np.clip(np.einsum("...x,...x->...", points - start, along) / length, 0.0, 1.0)
        foot = start + share[..., None] * along
        off = np.einsum("...x,...x->...", points - foot, points - foot)
        closer = off < gap
        best = np.where(closer[..., None], foot, best)
        gap = np.where(closer, off, gap)
    return np.asarray(best)


def _shares(points: FloatArray, corners: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the weights (...) of second and third corner, and whether a triangle has no area; both are 0 there."""
    a = corners[..., 0, :]
    ab, ac, ap = corners[..., 1, :] - a, corners[..., 2, :] - a, points - a
    normal = np.cross(ab, ac)
    size = np.einsum("...x,...x->...", normal, normal)
    flat = size <= 0.0
    size = np.where(flat, 1.0, size)
    second = np.einsum("...x,...x->...", np.cross(ap, ac), normal) / size
    third = np.einsum("...x,...x->...", np.cross(ab, ap), normal) / size
    return second, third, flat
