"""Detection of wrong markers by a chi-square test of each fitted residual; the worst is dropped, one after another.

The residual of a fit is smaller than the noise, because the fit follows its own data. For a fit that minimises prior
and data terms, the covariance of the residual is C_d - H P H', with the noise covariance C_d and the posterior
covariance H P H' of the predictions. The score of a marker is its misfit to the prediction from all others; the formula
is derived in `tissuereg-esmda`, module `outliers`.
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
    """Return a test of every marker: how far it lies from the fit to the others, and how probable that is.

    `residual` (n_markers, 3): measured minus fitted places, mm; NaN = not seen, ignored; `noise` (3 n_markers, 3
    n_markers): covariance C_d of the measurement noise and model errors, mm^2; `absorbed` (3 n_markers, 3 n_markers):
    posterior covariance H P H' of the markers' predictions, mm^2. Where errors of different markers are correlated, use
    the covariance of the linearised model (`Laplace.absorbed`): a covariance estimated from an ensemble is not exact
    enough. A marker keeps at least a twentieth of its noise. Result: arrays with one entry a marker. ``chi_square``:
    squared misfit to the others in its own standard deviations. ``n_obs``: number of components seen, its degrees of
    freedom. ``p_value``: the chance of a chi-square at least this large if the marker is good; 1 for a marker that was
    not seen. ``leverage``: the share of the marker's noise that the fit has absorbed. ``wrong(level)``: numbers of the
    markers whose p-value is below the level divided by the number of markers seen (Bonferroni), the worst first; in a
    set of good markers, any is found at most at the rate `level`. Raises `NoiseError` if the noise of a marker is not
    positive definite; `ShapeError` if the arrays do not fit each other.
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
    """Return a fit without the markers that do not fit the others, and the markers that were dropped.

    The worst marker is dropped if its p-value is beyond the level, the others are fitted again, and so on: a wrong
    marker spoils the residuals of good ones, so only one may go at a time. `fit`: function of the numbers of the
    markers to use, int64 (n_kept,), ascending, that returns a fit and the scores of these markers in the same order;
    `n_markers`: number of all markers; `level`: largest rate at which a good marker is dropped from a set without wrong
    ones; `max_dropped`: largest number of markers to drop; by default fewer than half, since wrong ones in the majority
    cannot be told. Result: the last fit, and a list of the dropped markers in the order of dropping, each with its
    number and the p-value that it had.
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
