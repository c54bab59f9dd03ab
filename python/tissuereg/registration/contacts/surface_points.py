r"""Unlabelled points of a deformed surface: each pass matches every point to the closest place of the body's surface.

Sliding along the surface is not observed: a point p with the closest place (foot) x on a triangle with normal n gives

    n . (p - x) = 0  +  noise,        row:  n times the barycentric weights of the foot's corners.

Its noise grows with its residual (Student's tail). Points whose match is uncertain, because the body is still far away,
count little in the first passes; points that belong to something else count little throughout.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.closest import closest_on_triangles
from tissuereg.body.mesh import Mesh
from tissuereg.body.surface import SurfacePoints, evenly
from tissuereg.registration.contacts.measured import Observations, tail_cost, tail_variance
from tissuereg.registration.contacts.settings import MATCHING
from tissuereg.registration.contacts.state import BodyState, RigidMotion


@dataclass(frozen=True, eq=False)
class Feet:
    """Closest places (feet) of a deformed surface to n_points given points.

    `corners` int64 (n_points, 3): nodes of the triangle that contains each foot; `weights` (n_points, 3): barycentric
    coordinates in it; `places` (n_points, 3): mm; `normals` (n_points, 3): outward unit normals of the triangles;
    `triangles` int64 (n_points,): number of the triangle among those of the surface.
    """

    corners: IntArray
    weights: FloatArray
    places: FloatArray
    normals: FloatArray
    triangles: IntArray

    def off(self, points: FloatArray, near: float) -> tuple[FloatArray, FloatArray]:
        """Return the signed distance of each point from the surface, (n_points,), mm, and its gradient, (n_points, 3).

        `points` (n_points, 3): mm, the ones that the feet belong to. The gradient is the normal within a triangle; at
        an edge of the body, for points farther away than `near` mm, it is the direction from the edge to the point,
        outward.
        """
        away = points - self.places
        along = np.einsum("px,px->p", away, self.normals)
        size = np.linalg.norm(away, axis=1)
        straight = away / np.maximum(size, 1e-300)[:, None] * np.where(along < 0.0, -1.0, 1.0)[:, None]
        directions = np.where((size > near)[:, None], straight, self.normals)
        return np.einsum("px,px->p", away, directions), directions


@dataclass(frozen=True, eq=False)
class PointData:
    """The unlabelled points of the surface as data of a registration.

    `mesh`: undeformed body; `places` (n_points, 3): measured, in the tracker's frame, mm; `noise`: standard deviation
    along the normal, mm; `model_error`: standard deviation of the model's error at a point, over its motion; `rough`:
    share of the extent within which matching errors are correlated, while the body is far away; 0 once it is near.
    """

    mesh: Mesh
    places: FloatArray
    noise: float
    model_error: float
    rough: float = 0.0

    @classmethod
    def of(cls, mesh: Mesh, points: SurfacePoints, model_error: float) -> "PointData":
        """Return checked `points` as data; `model_error`: standard deviation of the model, over a point's motion."""
        return cls(mesh, points.places, points.std, model_error)

    @property
    def n_obs(self) -> int:
        """Number of points."""
        return len(self.places)

    @cached_property
    def _alike(self) -> FloatArray:
        """Number of points within the correlation length of the model's error around each, with itself, (n_points,)."""
        return self._within(MATCHING.alike_share)

    @cached_property
    def _matched(self) -> FloatArray:
        """Number of points within the correlation length of matching errors around each, with itself, (n_points,)."""
        return self._within(self.rough) if self.rough else np.ones(self.n_obs)

    def _within(self, share: float) -> FloatArray:
        from scipy.spatial import cKDTree

        near = cKDTree(self.places).query_ball_point(self.places, share * self.mesh.extent, return_length=True)
        return np.asarray(near, np.float64)

    @cached_property
    def _facets(self) -> FloatArray:
        return facet_errors(self.mesh)

    def feet(self, state: BodyState) -> Feet:
        """Return the closest place of the deformed surface to each point, in the body's frame, mm."""
        moved = self.mesh.nodes + state.moved[: self.mesh.n_nodes]
        return closest_feet(moved, self.mesh.surface, state.frame.undo(self.places))

    def read(self, state: BodyState, *, weighed: bool = True, moved: FloatArray | None = None) -> Observations:
        """Return one observation per point: its distance from the surface at a deformed body, in mm.

        `weighed` is not used: outliers among the points always get a small weight; nor is `moved`: they are matched
        anew.
        """
        del weighed, moved
        feet = self.feet(state)
        std = self.std(state, feet)
        residual, directions = feet.off(state.frame.undo(self.places), MATCHING.far * self.noise)
        scaled = (residual / std) ** 2
        across = feet.weights[:, :, None] * directions[:, None, :]
        return Observations(
            list(zip(feet.corners, across, strict=True)),
            feet.places,
            directions,
            residual,
            std * np.sqrt(tail_variance(self._matched * scaled, 1)),
            tail_cost(scaled, 1),
            [],
        )

    def std(self, state: BodyState, feet: Feet) -> FloatArray:
        """Return the standard deviation of each point's distance from the surface, (n_points,), mm, without its tail.

        `state`: the body; `feet`: closest places of its surface. It combines the instrument's noise with errors of the
        model and of the facets. Nearby points share the latter, so that their variance is multiplied by the number of
        such points.
        """
        motion = state.moved[feet.corners]
        size = self.model_error * np.linalg.norm(np.einsum("pc,pcx->px", feet.weights, motion), axis=1)
        facet = self._facets[feet.triangles]
        return np.asarray(np.sqrt(self.noise**2 + self._alike * (size**2 + facet**2)))

    def distances(self, state: BodyState) -> tuple[FloatArray, FloatArray]:
        """Return each point's distance from the surface of a body, (n_points,), in mm, and in standard deviations."""
        feet = self.feet(state)
        residual, _ = feet.off(state.frame.undo(self.places), MATCHING.far * self.noise)
        return np.abs(residual), np.abs(residual) / self.std(state, feet)

    def outliers(self, state: BodyState) -> float:
        """Return the share of points, 0 to 1, that lie too many standard deviations from the surface of a body."""
        return float(np.mean(self.distances(state)[1] > MATCHING.outlier))

    def coarser(self, width: float) -> "PointData":
        """Return fewer points, spread evenly, for the first rounds of the fit, while the body is far away.

        `width`: distance within which errors of matching points to the surface are correlated, as a share of the
        extent.
        """
        return replace(self, places=self.places[evenly(self.places, MATCHING.coarse_points)], rough=width)


def closest_feet(nodes: FloatArray, triangles: IntArray, points: FloatArray) -> Feet:
    """Return the closest place of a surface to each of many points.

    `nodes` (n_nodes, 3): deformed places of nodes, mm; `triangles` int64 (n_triangles, 3): their surface, outward;
    `points` (n_points, 3): mm. Cost: about 3 ms for 500 points on 5,000 triangles.
    """
    from scipy.spatial import cKDTree

    corners = nodes[triangles]
    shares = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0], [2.0, 2.0, 2.0]]) / 6.0
    samples: Any = cKDTree(np.einsum("sc,tcx->tsx", shares, corners).reshape(-1, 3), balanced_tree=False)
    near = np.asarray(samples.query(points, k=min(MATCHING.closest, 4 * len(triangles)))[1]) // 4
    feet = closest_on_triangles(points[:, None], corners[near])
    best = np.argmin(np.sum((points[:, None] - feet) ** 2, axis=2), axis=1)
    rows = np.arange(len(points))
    chosen, place = near[rows, best], feet[rows, best]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[chosen]
    size = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    # Barycentric weights of a foot are shares of area: w_a = n . ((b - foot) x (c - foot)) / |2 area|.
    arms = corners[chosen] - place[:, None]
    parts = np.stack([np.cross(arms[:, i], arms[:, j]) for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    weights = np.clip(np.einsum("pcx,px->pc", parts, across) / size**2, 0.0, None)
    weights /= weights.sum(axis=1, keepdims=True)
    return Feet(triangles[chosen], weights, place, across / size, chosen)


def facet_errors(mesh: Mesh) -> FloatArray:
    """Return the estimated distance of each flat triangle from the curved surface it approximates, (n_triangles,), mm.

    It is a third of the largest sagitta ``1.7 edge x angle / 8`` of its edges, with the angle to the adjacent triangle;
    on a ball normals turn 1.7 times as much between the ends of an edge as between the centres of two triangles. Sharp
    edges belong to the body and count as flat.
    """
    corners = mesh.nodes[mesh.surface]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    edges = np.sort(mesh.surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    # Every edge of a closed surface occurs twice: sorted, its two triangles are adjacent.
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    first, second = order[:-1], order[1:]
    pairs = np.flatnonzero((edges[first] == edges[second]).all(axis=1))
    one, other, ends = first[pairs] // 3, second[pairs] // 3, edges[first[pairs]]
    cosine = np.clip(np.einsum("ex,ex->e", own[one], own[other]), -1.0, 1.0)
    length = np.linalg.norm(mesh.nodes[ends[:, 0]] - mesh.nodes[ends[:, 1]], axis=1)
    height = np.where(cosine > MATCHING.least_cosine, 1.7 * length * np.arccos(cosine) / 8.0, 0.0)
    largest = np.zeros(len(corners))
    np.maximum.at(largest, one, height)
    np.maximum.at(largest, other, height)
    return np.asarray(largest / 3.0)


def closest_frame(mesh: Mesh, points: FloatArray) -> RigidMotion:
    """Return the rigid motion of an undeformed body that brings its surface closest to measured points.

    `mesh`: undeformed body; `points` (n, 3): points of all or part of its deformed surface, in the tracker's frame, mm.
    Result: from the body's frame to the tracker's: the best of six starts (as given, moved onto the points' middle, and
    the latter with principal axes aligned in four ways), the first two preferred.
    """
    chosen = points[evenly(points, MATCHING.rigid_points)]
    found = [_iterated(mesh, chosen, start, MATCHING.rigid_first) for start in _starts(mesh, chosen)]
    left = np.array([off for _, off in found])
    left[1:] /= MATCHING.rigid_clearly
    left[2:] /= MATCHING.rigid_clearly
    return _iterated(mesh, chosen, found[int(np.argmin(left))][0], MATCHING.rigid_last)[0]


def _starts(mesh: Mesh, points: FloatArray) -> list[RigidMotion]:
    skin = mesh.nodes[mesh.surface_nodes]
    middle, goal = skin.mean(axis=0), points.mean(axis=0)
    own, theirs = (np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2] for p in (skin, points))
    starts = [RigidMotion.still(), RigidMotion(np.eye(3), goal - middle)]
    for first, second in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        turn = theirs.T @ np.diag([first, second, 1.0]) @ own
        turn = theirs.T @ np.diag([first, second, np.sign(np.linalg.det(turn))]) @ own
        starts.append(RigidMotion(turn, goal - turn @ middle))
    return starts


def _iterated(mesh: Mesh, points: FloatArray, frame: RigidMotion, count: int) -> tuple[RigidMotion, float]:
    """Return the rigid motion after `count` iterations, and the root mean square distance of the points used, mm.

    `mesh`: undeformed body; `points` (n, 3): in the tracker's frame, mm; `frame`: motion to start from. Each iteration
    uses the share of the points that lie closest to the surface.
    """
    length = 0.5 * mesh.extent
    for _ in range(count):
        places = frame.undo(points)
        feet = closest_feet(mesh.nodes, mesh.surface, places)
        off = places - feet.places
        near = np.argsort(np.linalg.norm(off, axis=1), kind="stable")[: max(3, int(MATCHING.rigid_share * len(points)))]
        pivot = feet.places[near].mean(axis=0)
        rows, goal = _rows(feet.places[near] - pivot, feet.normals[near], off[near], length)
        move = np.asarray(np.linalg.lstsq(rows, goal, rcond=1e-9)[0], np.float64)
        frame = frame.followed_by(move, np.stack([pivot, np.full(3, length)]))
        if float(np.linalg.norm(move)) < 1e-4 * mesh.extent:
            break
    gap = np.linalg.norm(frame.undo(points) - closest_feet(mesh.nodes, mesh.surface, frame.undo(points)).places, axis=1)
    return frame, float(np.sqrt(np.mean(np.sort(gap)[: max(3, int(MATCHING.rigid_share * len(points)))] ** 2)))


def _rows(arms: FloatArray, normals: FloatArray, off: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """Return matrix (4 n, 6) and right-hand side (4 n,), mm, of the least squares for a small motion onto a surface.

    `arms` (n, 3): feet of the points from the pivot, mm; `normals` (n, 3): unit normals; `off` (n, 3): points minus
    feet, mm; `length`: distance from the pivot at which a unit rotation moves by 1 mm, in mm. Distances along normals
    have weight one, those along the axes a small one.
    """
    parts, goals = [], []
    for directions, weight in (
        (normals, 1.0),
        *((np.tile(axis, (len(arms), 1)), MATCHING.rigid_along) for axis in np.eye(3)),
    ):
        parts.append(weight * np.concatenate([directions, np.cross(arms, directions) / length], axis=1))
        goals.append(weight * np.einsum("px,px->p", off, directions))
    return np.concatenate(parts), np.concatenate(goals)
