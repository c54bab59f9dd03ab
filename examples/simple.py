"""What an example compares a registration with: where a point goes by the markers alone; no mesh, no material."""

import numpy as np


def copied(before: np.ndarray, after: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the displacement (3,) of a point that moves as the markers (n, 3) do in the mean."""
    return (after - before).mean(axis=0)


def rigid(before: np.ndarray, after: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the displacement (3,) of a point under the best rigid motion of three markers (n, 3) or more (Kabsch)."""
    from scipy.spatial.transform import Rotation

    turn, _ = Rotation.align_vectors(after - after.mean(axis=0), before - before.mean(axis=0))
    return turn.apply(point - before.mean(axis=0)) + after.mean(axis=0) - point


def spline(before: np.ndarray, after: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the displacement (3,) of a point on the thin-plate spline through markers (n, 3) that span a volume."""
    from scipy.interpolate import RBFInterpolator

    spread = np.linalg.svd(before - before.mean(axis=0), compute_uv=False)
    if len(before) < 4 or spread[-1] < 1e-9 * spread[0]:
        return copied(before, after, point)
    return RBFInterpolator(before, after - before, kernel="thin_plate_spline")(point[None])[0]
