"""Empirical-Bayes guard: a prior that cannot explain the markers is widened, and the result reports it."""

from collections.abc import Callable

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.latent.model import Gaussian

#: Number of members that estimate the prior's prediction.
_N_MEMBERS = 100

#: No prior is widened beyond this factor on its covariance.
MOST = 400.0

#: Significance level at which an innovation is too large for the prior.
_LEVEL = 0.05


def widened(
    prior: Gaussian,
    family: Gaussian,
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray,
    rng: np.random.Generator,
) -> tuple[Gaussian, float]:
    """Return the prior, widened if the innovation is too large for it, and the factor.

    Parameters
    ----------
    prior : Gaussian
        Prior of the latents.
    family : Gaussian
        Distribution of the latents of all training fields; no direction is widened beyond its spread.
    predict : callable
        Latents (n_latent, n_members) to predictions (n_obs, n_members) in mm.
    observed : ndarray of float64, shape (n_obs,)
        Measured marker displacements in mm.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance C_d, mm^2.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    prior : Gaussian
        The same mean; covariance ``((s C)^-1 + L^-1)^-1`` with the prior's C and the family's L: about s C where that
        is small compared with L, and L where it is large. Unchanged if s = 1.
    factor : float
        Smallest s >= 1 with ``v' (H C(s) H' + C_d)^-1 v = n_obs`` for the innovation v, if ``s = 1`` misses the 95 %
        quantile of its chi-square law; 1 otherwise, and at most `MOST`.

    Notes
    -----
    The maximum-likelihood inflation of data assimilation, J. L. Anderson, "An adaptive covariance inflation error
    correction algorithm for ensemble filters", Tellus A 59, 210-224, 2007, with one factor for the whole prior. The
    bound matters: on 80 pairs of the phantom, widening without it moved some codes outside the decoder's training data,
    and those bodies ended with larger errors than they began with.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2

    root = np.linalg.cholesky(prior.covariance)
    draws = rng.standard_normal((len(prior.mean), _N_MEMBERS))
    predicted = predict(np.concatenate([prior.mean[:, None], prior.mean[:, None] + root @ draws], axis=1))
    centre, spread = predicted[:, 0], predicted[:, 1:]
    whole = np.isfinite(spread).all(axis=0)
    if whole.sum() <= len(prior.mean) or not np.isfinite(centre).all():
        return prior, 1.0
    # Predictions as a linear function of latents, by regression on the draws.
    slope = np.linalg.lstsq(draws[:, whole].T, (spread[:, whole] - centre[:, None]).T, rcond=None)[0].T
    slope = np.linalg.solve(root.T, slope.T).T
    precision, bound = np.linalg.inv(prior.covariance), np.linalg.inv(family.covariance)
    innovation = observed - centre

    def covariance(factor: float) -> FloatArray:
        inverse = np.linalg.inv(precision / factor + bound)
        return np.asarray(0.5 * (inverse + inverse.T))

    def misfit(spread_of_latents: FloatArray) -> float:
        return float(innovation @ np.linalg.solve(slope @ spread_of_latents @ slope.T + noise, innovation))

    n_obs = len(observed)
    if misfit(prior.covariance) <= chi2.isf(_LEVEL, n_obs):
        return prior, 1.0
    # The bound can only raise the misfit, so it is above n_obs at s = 1.
    enough = misfit(covariance(MOST)) <= n_obs
    factor = float(brentq(lambda s: misfit(covariance(s)) - n_obs, 1.0, MOST)) if enough else MOST
    return Gaussian(prior.mean, covariance(factor)), factor
