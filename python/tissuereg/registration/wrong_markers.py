"""Markers that do not fit the others: a chi-square each on the fitted residual, and the worst dropped one by one.

The residual of a fit is smaller than the noise, because the fit follows its own data. Of a fit that minimises prior and
data terms its covariance is C_d - H P H', with H P H' the posterior covariance of the predictions, and the score of a
marker is its misfit to the prediction from all others; derived in `tissuereg-esmda`, module `outliers`.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, float_array

#: Rate at which a good marker is dropped from a set without wrong ones.
LEVEL = 0.005

_Fit = TypeVar("_Fit")


def score_markers(residual: FloatArray, noise: FloatArray, absorbed: FloatArray) -> _core.GroupScores:
    """Return how far markers lie from a fit.

    Parameters
    ----------
    residual : ndarray of float64, shape (n_markers, 3)
        Measured minus fitted, mm; NaN = not seen, ignored.
    noise : ndarray of float64, shape (3 n_markers, 3 n_markers)
        Covariance C_d, mm^2.
    absorbed : ndarray of float64, shape (3 n_markers, 3 n_markers)
        Posterior covariance H P H' of the markers' predictions, mm^2. Where errors of different markers are correlated,
        take that of the linearised model (`Laplace.absorbed`): one estimated from an ensemble is not exact enough. A
        marker keeps at least a twentieth of its noise.

    Returns
    -------
    _core.GroupScores
        Arrays with one entry a marker. ``chi_square``: squared misfit to the others in its own standard deviations.
        ``n_obs``: components seen, its degrees of freedom. ``p_value``: the chance of a chi-square at least this large
        if the marker is good; 1 for one that was not seen. ``leverage``: the share of its noise that the fit has
        absorbed. ``wrong(level)``: markers beyond the level, shared out evenly among those that were seen (Bonferroni),
        the worst first; `level` is the rate at which any of a set of good markers is among them, at most.

    Raises
    ------
    NoiseError
        If the noise of a marker is not positive definite.
    ShapeError
        If the arrays do not fit each other.
    """
    residual = float_array("residual", residual, (None, 3))
    n_markers, rows = len(residual), residual.ravel()
    shape = (len(rows), len(rows))
    seen = np.flatnonzero(np.isfinite(rows))
    block = np.ix_(seen, seen)
    return _core.GroupScores(
        rows[seen],
        np.ascontiguousarray(float_array("noise", noise, shape)[block]),
        np.ascontiguousarray(float_array("absorbed", absorbed, shape)[block]),
        seen // 3,
        n_markers,
    )


def most_wrong(n_markers: int) -> int:
    """Return how many of some markers can be told to be wrong: fewer than half, a majority agrees with itself."""
    return (n_markers - 1) // 2


def drop_wrong(
    fit: Callable[[IntArray], tuple[_Fit, _core.GroupScores]],
    n_markers: int,
    *,
    level: float = LEVEL,
    max_dropped: int | None = None,
) -> tuple[_Fit, list[tuple[int, float]]]:
    """Return a fit without the markers that do not fit the others.

    The worst marker is dropped if it is beyond the level, the rest is fitted again, and so on: a wrong marker spoils
    the residuals of good ones, so only one may go at a time. `fit`: markers to use, int64 (n_kept,), ascending, to a
    fit and its scores, in that order; `n_markers`: number of markers; `level`: rate at which a good marker is dropped
    from a set without wrong ones, at most; `max_dropped`: no more are dropped; by default fewer than half, since wrong
    ones in the majority cannot be told. Result: `fit`: the last fit; `dropped`: markers that were dropped, in this
    order, each with the p-value that it had.
    """
    most = most_wrong(n_markers) if max_dropped is None else max_dropped
    kept = np.arange(n_markers)
    dropped: list[tuple[int, float]] = []
    while True:
        found, scores = fit(kept)
        wrong = scores.wrong(level)
        if not wrong or len(dropped) >= most:
            return found, dropped
        worst = wrong[0]
        dropped.append((int(kept[worst]), float(scores.p_value[worst])))
        kept = np.delete(kept, worst)
