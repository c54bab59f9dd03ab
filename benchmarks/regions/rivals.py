"""Rivals that state a variance: a spline with its leave-one-out errors, and a Gaussian process of displacements."""

import numpy as np
from scipy.interpolate import RBFInterpolator

#: Lengths of the Gaussian process over the spread of the markers, and its sizes over their motion.
LENGTHS, SIZES = np.geomspace(0.1, 3.0, 12), np.geomspace(0.03, 3.0, 12)

#: Variance of the affine part of the Gaussian process, over the square of the motion.
AFFINE = 10.0


def spline(
    places: np.ndarray, moved: np.ndarray, std: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (k, 3) at targets and variances (k, 3, 3) by a thin-plate spline through markers (n, 3).

    The variance along each axis is that of the leave-one-out errors of the markers; `std` is not used.
    """
    del std

    def through(some: np.ndarray, at: np.ndarray) -> np.ndarray:
        return RBFInterpolator(places[some], moved[some], kernel="thin_plate_spline", degree=1)(at)

    every = np.arange(len(places))
    off = np.array([moved[i] - through(np.delete(every, i), places[i : i + 1])[0] for i in every])
    return through(every, targets), np.tile(np.diag(np.mean(off**2, axis=0)), (len(targets), 1, 1))


def gaussian(
    places: np.ndarray, moved: np.ndarray, std: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (k, 3) at targets and covariances (k, 3, 3) by a Gaussian process with an affine part.

    Its covariance is that of Matern with smoothness 3/2; length and size are those of the highest evidence. `places`,
    `moved` (n, 3): of markers; `std` (n, 3): their noise.
    """
    middle, spread = places.mean(axis=0), float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))
    motion = float(np.sqrt(np.mean(np.sum(moved**2, axis=1)) / 3.0))
    best = None
    for share in LENGTHS:
        for size in SIZES:
            covariance = _Covariance(middle, spread, share * spread, size * motion, AFFINE * motion**2)
            found = _given(covariance, places, moved, std, targets)
            if best is None or found[0] > best[0]:
                best = found
    return best[1], best[2]


class _Covariance:
    def __init__(self, middle: np.ndarray, spread: float, length: float, size: float, affine: float) -> None:
        self.middle, self.spread, self.length, self.size, self.affine = middle, spread, length, size, affine

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        q = np.sqrt(3.0) * np.linalg.norm(x[:, None] - y[None], axis=2) / self.length
        return self.size**2 * (1.0 + q) * np.exp(-q) + self.affine * self._trend(x) @ self._trend(y).T

    def _trend(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([np.ones((len(x), 1)), (x - self.middle) / self.spread], axis=1)


def _given(covariance, places, moved, std, targets) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log evidence, and means (k, 3) and covariances (k, 3, 3) of the targets."""
    among, across = covariance(places, places), covariance(targets, places)
    own = np.diag(covariance(targets, targets))
    evidence, mean, left = 0.0, np.zeros((len(targets), 3)), np.zeros((len(targets), 3, 3))
    for axis in range(3):
        factor = np.linalg.cholesky(among + np.diag(std[:, axis] ** 2) + 1e-9 * among[0, 0] * np.eye(len(places)))
        white = np.linalg.solve(factor, moved[:, axis])
        half = np.linalg.solve(factor, across.T)
        evidence -= 0.5 * white @ white + np.log(np.diag(factor)).sum()
        mean[:, axis] = half.T @ white
        left[:, axis, axis] = np.maximum(own - np.sum(half**2, axis=0), 0.0)
    return float(evidence), mean, left


RIVALS = {"spline": spline, "gaussian": gaussian}
