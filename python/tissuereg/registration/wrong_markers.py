"""Detection of wrong markers by a chi-square test of each fitted residual.

The residual of a fit is smaller than the noise, because the fit follows its own data. For a fit that minimises prior
and data terms, the covariance of the residual is C_d - H P H', with the noise covariance C_d and the posterior
covariance H P H' of the predictions. The score of a marker is its misfit to the prediction from all others; the formula
is derived in `tissuereg-esmda`, module `outliers`.
"""

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, float_array


def score_markers(residual: FloatArray, noise: FloatArray, absorbed: FloatArray) -> _core.GroupScores:
    """Return a test of every marker: how far it lies from the fit to the others, and how probable that is.

    `residual` (n_markers, 3): measured minus fitted places, mm; NaN = not seen, ignored; `noise` (3 n_markers, 3
    n_markers): covariance C_d of the measurement noise and model errors, mm^2; `absorbed` (3 n_markers, 3 n_markers):
    posterior covariance H P H' of the markers' predictions, mm^2. Where errors of different markers are correlated, use
    the covariance of a linearised model: one estimated from samples is not exact enough. A marker keeps at least a
    twentieth of its noise. Result: arrays with one entry a marker. ``chi_square``: squared misfit to the others in its
    own standard deviations. ``n_obs``: number of components seen, its degrees of freedom. ``p_value``: the chance of a
    chi-square at least this large if the marker is good; 1 for a marker that was not seen. ``leverage``: the share of
    the marker's noise that the fit has absorbed. ``wrong(level)``: numbers of the markers whose p-value is below the
    level divided by the number of markers seen (Bonferroni), the worst first; in a set of good markers, any is found at
    most at the rate `level`. Raises `NoiseError` if the noise of a marker is not
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
