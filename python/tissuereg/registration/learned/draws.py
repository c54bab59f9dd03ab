"""Draws of a first ensemble, and what its finite size costs."""

import numpy as np

from tissuereg._base.arrays import FloatArray

#: A predicted marker displacement beyond this many mm marks a failed member.
ABSURD_MM = 1e4


def spread_factor(n_members: int, *, exact: bool) -> float:
    """Return the factor on covariances that corrects for an ensemble being finite.

    Mean and covariance estimated from n independent members predict a further draw with the covariance times ``(1 +
    1/n)(n - 1)/(n - 3)`` (variance of Student's t). For draws with `exact` sample moments the factor is one.
    """
    return 1.0 if exact else (1.0 + 1.0 / n_members) * (n_members - 1.0) / max(n_members - 3.0, 1.0)


def balanced_draws(rng: np.random.Generator, shape: tuple[int, int], anomalies: FloatArray) -> tuple[FloatArray, bool]:
    """Return standard normal draws whose sample moments are exact, if the ensemble is large enough.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of random numbers.
    shape : (int, int)
        Rows (dimensions) and columns (members).
    anomalies : ndarray of float64, shape (k, n_members)
        Zero-mean rows with which the draws must be uncorrelated.

    Returns
    -------
    draws : ndarray of float64, shape `shape`
        Mean zero, sample covariance the identity, sample correlation with `anomalies` zero.
    exact : bool
        False if there are too few members for that; the draws are then plain.

    Notes
    -----
    With such draws the stochastic update reproduces the Kalman mean and covariance exactly if the model is
    linear: the usual loss of spread, about n_obs/n_members of it, comes from these sampling errors alone.
    Needs n_members > rows + rank(anomalies) + 1.
    """
    draws = rng.standard_normal(shape)
    rows, n_members = shape
    if n_members <= rows + len(anomalies) + 1:
        return draws, False
    taken = np.vstack([np.ones((1, n_members)), anomalies])
    basis, triangle = np.linalg.qr(taken.T)
    lengths = np.abs(np.diag(triangle))
    if not lengths.min() > 1e-9 * lengths.max():
        # Rows that depend on others have no direction of their own.
        basis, singular, _ = np.linalg.svd(taken.T, full_matrices=False)
        basis = basis[:, singular > 1e-12 * singular.max()]
    draws -= (draws @ basis) @ basis.T
    root = np.linalg.cholesky(draws @ draws.T / (n_members - 1))
    return np.ascontiguousarray(np.linalg.solve(root, draws)), True
