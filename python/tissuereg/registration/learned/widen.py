"""Prior and noise of a registration; a prior that cannot explain the markers is widened, and the result says so."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.markers import Markers
from tissuereg.registration.learned.model import Gaussian, error_covariance
from tissuereg.registration.learned.points import PointsAround

#: No prior is widened beyond this factor on its covariance.
MOST = 400.0

#: Significance level at which an innovation is too large for the prior.
_LEVEL = 0.05


@dataclass(frozen=True, eq=False)
class LinearPredictions:
    """Predicted marker displacements as a linear function of the latents z: ``centre + slope (z - mean of the prior)``.

    `centre` (n_obs,) are the predictions at the mean, in mm; `slope` (n_obs, n_latent) are their derivatives, in mm.
    """

    centre: FloatArray
    slope: FloatArray

    @classmethod
    def of(
        cls, prior: Gaussian, latents: FloatArray, predicted: FloatArray, centre: FloatArray
    ) -> "LinearPredictions | None":
        """Return the regression of predictions on latents drawn from the prior; None if too few members are finite.

        `prior` is the prior of the latents; `latents` (n_latent, n_members) are draws from it; `predicted` (n_obs,
        n_members) are their predictions, in mm, of which members that are not finite are left out; `centre` (n_obs,)
        are the predictions at the prior's mean, in mm.
        """
        whole = np.isfinite(predicted).all(axis=0)
        if whole.sum() <= len(prior.mean) or not np.isfinite(centre).all():
            return None
        root = np.linalg.cholesky(prior.covariance)
        draws = np.linalg.solve(root, latents[:, whole] - prior.mean[:, None])
        moments = np.linalg.solve(draws @ draws.T, draws @ (predicted[:, whole] - centre[:, None]).T)
        return cls(centre, np.linalg.solve(root.T, moments).T)

    def most_probable(self, prior: Gaussian, observed: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the posterior mean (n_latent,) of the latents under the linear model.

        `observed` (n_obs,) are the measured displacements, in mm, and `noise` (n_obs, n_obs) their covariance, in mm^2.
        """
        gain = prior.covariance @ self.slope.T
        off = np.linalg.solve(self.slope @ gain + noise, observed - self.centre)
        return np.asarray(prior.mean + gain @ off)


def widened(
    prior: Gaussian, family: Gaussian, linear: LinearPredictions, observed: FloatArray, noise: FloatArray
) -> tuple[Gaussian, float]:
    """Return the prior, widened if the innovation is too large for it, and the factor by which it was widened.

    `prior` is the prior of the latents; `family` is the distribution of the latents of all training fields, beyond
    whose spread no direction is widened; `linear` holds the predictions about the prior's mean; `observed` (n_obs,) are
    the measured marker displacements, in mm; `noise` (n_obs, n_obs) is the covariance C_d, in mm^2. The first result
    has the same mean and the covariance ``C(s) = ((s C)^-1 + L^-1)^-1`` with the prior's C and the family's L: about s
    C where that is small compared with L, and L where it is large; it is the given prior if s = 1. The second is s, the
    smallest s >= 1 with ``v' (H C(s) H' + C_d)^-1 v = n_obs`` for the innovation v and the slope H of `linear`, if ``s
    = 1`` exceeds the 95 % quantile of its chi-square law; 1 otherwise, and at most `MOST`.

    Notes
    -----
    The maximum-likelihood inflation of data assimilation, J. L. Anderson, "An adaptive covariance inflation error
    correction algorithm for ensemble filters", Tellus A 59, 210-224, 2007, with one factor for the whole prior. Without
    the bound L, widening moved some latents of phantom pairs outside the decoder's training data, and those bodies
    ended with larger errors than they began with.
    """
    from scipy.optimize import brentq

    slope, innovation = linear.slope, observed - linear.centre

    def misfit(spread_of_latents: FloatArray) -> float:
        return float(innovation @ np.linalg.solve(slope @ spread_of_latents @ slope.T + noise, innovation))

    n_obs = len(observed)
    if misfit(prior.covariance) <= _quantile(n_obs):
        return prior, 1.0
    precision, bound = np.linalg.inv(prior.covariance), np.linalg.inv(family.covariance)

    def covariance(factor: float) -> FloatArray:
        inverse = np.linalg.inv(precision / factor + bound)
        return np.asarray(0.5 * (inverse + inverse.T))

    # The bound can only raise the misfit, so it is above n_obs at s = 1.
    enough = misfit(covariance(MOST)) <= n_obs
    factor = float(brentq(lambda s: misfit(covariance(s)) - n_obs, 1.0, MOST)) if enough else MOST
    return Gaussian(prior.mean, covariance(factor)), factor


@dataclass(frozen=True, eq=False)
class Stated:
    """Prior and noise of one registration, before its latents are found.

    `prior` is the prior of the latents, widened if the markers require it; `factor` is the factor on its covariance by
    which it was widened; `noise` (n_obs, n_obs) is C_d, the covariance of the tracker's noise and of the model's own
    errors at the markers, in mm^2; `near` (n_latent,) are the most probable latents of a linear model, at which these
    errors are taken unless a typical event's are.
    """

    prior: Gaussian
    factor: float
    noise: FloatArray
    near: FloatArray


def stated(
    model: PointsAround,
    markers: Markers,
    seen: IntArray,
    latents: FloatArray,
    predicted: FloatArray,
    centre: FloatArray,
    *,
    typical: bool = False,
) -> Stated:
    """Return the prior and the noise of one registration, from draws of the model's prior.

    `model` is the latent model at the markers; `markers` holds the measurements; `seen` int64 (n_seen,) are the numbers
    of the markers that are used; `latents` (n_latent, n_members) are draws from the prior, and `predicted` (3 n_seen,
    n_members) their predictions for these markers, in mm; `centre` (3 n_seen,) are the predictions at the prior's mean,
    in mm; `typical` says to take the errors of a typical event rather than those at the latents of the linear model.
    Where no linear model can be fitted to the draws, the result is the model's own prior and the errors at its mean.
    """
    measured = markers.displacement[seen].ravel()
    linear = LinearPredictions.of(model.prior, latents, predicted, centre)

    def prior_for(noise: FloatArray) -> tuple[Gaussian, float]:
        return (model.prior, 1.0) if linear is None else widened(model.prior, model.family, linear, measured, noise)

    noise = _noise(model.errors().markers[:, seen], markers, seen)
    prior, factor = prior_for(noise)
    near = model.prior.mean if linear is None else linear.most_probable(prior, measured, noise)
    if not typical:
        noise = _noise(model.errors(near).markers[:, seen], markers, seen)
        prior, factor = prior_for(noise)
    return Stated(prior, factor, noise, near)


def _noise(errors: FloatArray, markers: Markers, seen: IntArray) -> FloatArray:
    """Return C_d (3 n_seen, 3 n_seen), in mm^2: the covariance of the tracker's noise plus that of the model's errors.

    `errors` (n_fields, n_seen, 3) are the model's errors at the markers with numbers `seen` int64 (n_seen,), in mm.
    """
    tracker = (markers.axis_std[seen] ** 2).ravel()
    return np.asarray(np.diag(tracker) + error_covariance(errors.reshape(len(errors), 3 * len(seen))))


@lru_cache
def _quantile(n_obs: int) -> float:
    """Return the 95 % quantile of the chi-square law with n_obs degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.isf(_LEVEL, n_obs))
