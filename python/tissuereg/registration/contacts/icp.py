"""The rigid motion of a body that brings its surface closest to unlabelled points (iterated closest points)."""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.body.surface import evenly
from tissuereg.registration.contacts.settings import MATCHING
from tissuereg.registration.contacts.state import RigidMotion
from tissuereg.registration.contacts.surface_points import closest_feet


def closest_frame(mesh: Mesh, points: FloatArray) -> RigidMotion:
    """Return the rigid motion of a body to points of its surface.

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
    """Return the frame after some iterations and the root mean square distance of the points that are used, mm."""
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
    """Return the linear system of a small motion: along normals with weight one, along axes with a small one."""
    parts, goals = [], []
    for directions, weight in (
        (normals, 1.0),
        *((np.tile(axis, (len(arms), 1)), MATCHING.rigid_along) for axis in np.eye(3)),
    ):
        parts.append(weight * np.concatenate([directions, np.cross(arms, directions) / length], axis=1))
        goals.append(weight * np.einsum("px,px->p", off, directions))
    return np.concatenate(parts), np.concatenate(goals)
