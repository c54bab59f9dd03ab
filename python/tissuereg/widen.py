"""Empirical-Bayes guard: a prior that cannot explain the markers is widened, and the result says so."""

from collections.abc import Callable

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.latent.model import Gaussian

#: Members that estimate what the prior predicts.
_N_MEMBERS = 100

#: No prior is widened beyond this factor on its covariance.
MOST = 400.0

#: Upper tail of the chi-square below which an innovation is left to chance.
_LEVEL = 0.05


def widened(
    prior: Gaussian,
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray,
    rng: np.random.Generator,
) -> tuple[Gaussian, float]:
    """Return the prior, its covariance scaled up where the innovation is too large for it, and the factor.

    Parameters
    ----------
    prior : Gaussian
        Where the latents are expected.
    predict : callable
        Latents (n_latent, n_members) to predictions (n_obs, n_members) in mm.
    observed : ndarray of float64, shape (n_obs,)
        Measured marker displacements in mm.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance C_d, mm^2.
    rng : numpy.random.Generator
        Source of chance.

    Returns
    -------
    prior : Gaussian
        The same mean; the covariance times the factor.
    factor : float
        Smallest s >= 1 with ``v' (s C_yy + C_d)^-1 v = n_obs`` for the innovation v, if ``s = 1`` misses the 95 %
        quantile of its chi-square law; 1 otherwise.

    Notes
    -----
    The maximum-likelihood inflation of data assimilation, J. L. Anderson, "An adaptive covariance inflation error
    correction algorithm for ensemble filters", Tellus A 59, 210-224, 2007, with one factor for the whole prior.
    """
    from scipy.linalg import eigh
    from scipy.optimize import brentq
    from scipy.stats import chi2

    root = np.linalg.cholesky(prior.covariance)
    sample = prior.mean[:, None] + root @ rng.standard_normal((len(prior.mean), _N_MEMBERS))
    predicted = predict(np.concatenate([prior.mean[:, None], sample], axis=1))
    centre, spread = predicted[:, 0], predicted[:, 1:]
    spread = spread[:, np.isfinite(spread).all(axis=0)]
    if spread.shape[1] < 2 or not np.isfinite(centre).all():
        return prior, 1.0
    values, vectors = eigh(np.atleast_2d(np.cov(spread)), noise)  # vectors whiten the noise
    along = (vectors.T @ (observed - centre)) ** 2
    values = np.maximum(values, 0.0)

    def misfit(factor: float) -> float:
        return float(np.sum(along / (factor * values + 1.0)))

    n_obs = len(observed)
    if misfit(1.0) <= chi2.isf(_LEVEL, n_obs):
        return prior, 1.0
    factor = MOST if misfit(MOST) > n_obs else float(brentq(lambda s: misfit(s) - n_obs, 1.0, MOST))
    return Gaussian(prior.mean, factor * prior.covariance), factor
