"""Readings (ways to interpret the input) with a rigid motion of all places, or of reference or measured ones alone."""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.reading import Given, Reading
from tissuereg.registration.readings.settings import COSTS, PROPOSALS


def best_rigid(start: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotations (..., 3, 3) and shifts (..., 3) in mm that move points onto others, robust to a few wrong ones.

    `start`, `end` (..., n, 3): the points before and after the motion, mm.

    Notes
    -----
    Kabsch's rotation with weights 1 / distance, iterated: it minimises the sum of distances, not of their squares.
    """
    weights = np.ones(end.shape[:-1])
    for _ in range(PROPOSALS.align):
        share = (weights / weights.sum(axis=-1, keepdims=True))[..., None]
        middle, target = (share * start).sum(axis=-2), (share * end).sum(axis=-2)
        across = np.swapaxes(end - target[..., None, :], -1, -2) @ (share * (start - middle[..., None, :]))
        u, _, vt = np.linalg.svd(across)
        u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
        turn = u @ vt
        shift = target - np.einsum("...xy,...y->...x", turn, middle)
        off = np.linalg.norm(moved(start, turn, shift) - end, axis=-1)
        weights = 1.0 / np.maximum(off, 0.1 * np.median(off, axis=-1, keepdims=True) + 1e-6)
    return turn, shift


def moved(points: FloatArray, turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Return points (..., n, 3), mm, after rotations `turn` (..., 3, 3) and then translations `shift` (..., 3), mm."""
    return np.asarray(points @ np.swapaxes(turn, -1, -2) + shift[..., None, :])


def measured_moved(given: Given) -> list[Reading]:
    """Return the reading (interpretation) in which a rigid motion was applied to all measured places by mistake.

    The motion is fitted to the displacements of the markers. The list has at most one reading, and none if the body
    itself may move rigidly.
    """
    rows = given.complete
    if rows.sum() < PROPOSALS.fewest_moved or not len(given.held_nodes):
        return []
    turn, shift = best_rigid(given.reference[rows], given.measured[rows])
    held = given.held_nodes
    slip = float(np.linalg.norm(moved(held, turn, shift) - held, axis=1).mean())
    if slip < max(PROPOSALS.smallest_mm, PROPOSALS.smallest_share * given.skin.extent) + 4.0 * given.noise:
        return []
    arms = moved(given.reference, turn, shift)
    words = f"the measured places if moved back {_described(turn, shift, given)}"
    return [
        Reading("rigid motion", words, COSTS.moved, given.reference, given.measured - arms, arms, rigid=True),
    ]


def places_moved(given: Given) -> list[Reading]:
    """Return readings (ways to interpret the input) with a rigid motion of the reference places onto the surface.

    It is applied to the reference places alone, or to the measured ones, too.
    """
    x, y, rows = given.reference, given.measured, given.complete
    starts, alone = [], []
    if rows.sum() >= PROPOSALS.fewest_moved:
        starts.append(best_rigid(x[rows], y[rows]))
        alone.append(True)
    if len(x) >= PROPOSALS.fewest_places:
        surface = given.skin.closest(x).foot.mean(axis=0)
        for shift in (np.zeros(3), given.skin.middle - x.mean(axis=0), surface - x.mean(axis=0)):
            starts.append((np.eye(3), shift))
            alone.append(False)
    if not starts:
        return []
    turns, shifts = _slid(given, np.array([s[0] for s in starts]), np.array([s[1] for s in starts]))
    readings = []
    for turn, shift, apart in zip(turns, shifts, alone, strict=True):
        places = moved(x, turn, shift)
        words = f"{'the reference places' if apart else 'all markers'} if moved {_described(turn, shift, given)}"
        motion, arms = (y - places, places) if apart else (given.motion, x)
        readings.append(Reading("rigid motion", words, COSTS.fitted + (0.0 if apart else 2.0), places, motion, arms))
    return readings


def _slid(given: Given, turn: FloatArray, shift: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return s rigid motions that bring the reference places to the surface: (s, 3, 3) and (s, 3), mm.

    `turn` (s, 3, 3), `shift` (s, 3): rotations and shifts to start from; distances from the surface are minimised point
    to plane.
    """
    extent = given.skin.extent
    size = np.concatenate([np.ones(3), np.full(3, (0.5 * extent) ** 2)])
    for _ in range(PROPOSALS.slide):
        places = moved(given.reference, turn, shift)
        near = given.skin.closest(places)
        middle = places.mean(axis=1)
        slopes = np.concatenate([near.normal, np.cross(places - middle[:, None], near.normal)], axis=2)
        weights = 1.0 / np.maximum(np.abs(near.distance), 0.01 * extent)
        metric = np.einsum("sn,sni,snj->sij", weights, slopes, slopes)
        metric += 1e-3 * weights.sum(axis=1)[:, None, None] * np.diag(size)
        step = np.linalg.solve(metric, -np.einsum("sn,sni,sn->si", weights, slopes, near.distance)[..., None])[..., 0]
        small = _rotation(step[:, 3:])
        turn, shift = small @ turn, np.einsum("sxy,sy->sx", small, shift - middle) + middle + step[:, :3]
    return turn, shift


def _rotation(vector: FloatArray) -> FloatArray:
    """Return rotation matrices (s, 3, 3) of rotation vectors (s, 3), in radians."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _described(turn: FloatArray, shift: FloatArray, given: Given) -> str:
    """Return a rigid motion in words: how far it moves the markers' middle, mm, and its angle, degrees.

    `turn` (3, 3): rotation; `shift` (3,): mm.
    """
    middle = given.reference.mean(axis=0)
    far = float(np.linalg.norm(turn @ middle + shift - middle))
    angle = float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))))
    return f"by {far:.1f} mm and turned by {angle:.0f} degrees"
