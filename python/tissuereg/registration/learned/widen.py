"""Prior and noise of a moment; a prior that cannot explain the markers is widened, and the result reports it."""

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
    """Predictions as a linear function of latents, about the mean of their prior.

    `centre` (n_obs,): predictions at the mean, mm; `slope` (n_obs, n_latent): mm.
    """

    centre: FloatArray
    slope: FloatArray

    @classmethod
    def of(
        cls, prior: Gaussian, latents: FloatArray, predicted: FloatArray, centre: FloatArray
    ) -> "LinearPredictions | None":
        """Return the regression of predictions on latents drawn from the prior.

        `prior`: prior of the latents; `latents` (n_latent, n_members): draws; `predicted` (n_obs, n_members): their
        predictions, mm; members that are not finite are left out; `centre` (n_obs,): predictions at the prior's mean,
        mm. Result: None if too few predictions are finite.
        """
        whole = np.isfinite(predicted).all(axis=0)
        if whole.sum() <= len(prior.mean) or not np.isfinite(centre).all():
            return None
        root = np.linalg.cholesky(prior.covariance)
        draws = np.linalg.solve(root, latents[:, whole] - prior.mean[:, None])
        moments = np.linalg.solve(draws @ draws.T, draws @ (predicted[:, whole] - centre[:, None]).T)
        return cls(centre, np.linalg.solve(root.T, moments).T)

    def most_probable(self, prior: Gaussian, observed: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the posterior mean (n_latent,) of the linear model."""
        gain = prior.covariance @ self.slope.T
        off = np.linalg.solve(self.slope @ gain + noise, observed - self.centre)
        return np.asarray(prior.mean + gain @ off)


def widened(
    prior: Gaussian, family: Gaussian, linear: LinearPredictions, observed: FloatArray, noise: FloatArray
) -> tuple[Gaussian, float]:
    """Return the prior, widened if the innovation is too large for it, and the factor.

    `prior`: prior of the latents; `family`: distribution of the latents of all training fields; no direction is widened
    beyond its spread; `linear`: predictions about the prior's mean; `observed` (n_obs,): measured marker displacements
    in mm; `noise` (n_obs, n_obs): covariance C_d, mm^2. Result: `prior`: the same mean; covariance ``((s C)^-1 +
    L^-1)^-1`` with the prior's C and the family's L: about s C where that is small compared with L, and L where it is
    large. Unchanged if s = 1; `factor`: smallest s >= 1 with ``v' (H C(s) H' + C_d)^-1 v = n_obs`` for the innovation
    v, if ``s = 1`` misses the 95 % quantile of its chi-square law; 1 otherwise, and at most `MOST`.

    Notes
    -----
    The maximum-likelihood inflation of data assimilation, J. L. Anderson, "An adaptive covariance inflation error
    correction algorithm for ensemble filters", Tellus A 59, 210-224, 2007, with one factor for the whole prior. The
    bound matters: on 80 pairs of the phantom, widening without it moved some codes outside the decoder's training data,
    and those bodies ended with larger errors than they began with.
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
    """Prior and noise of one moment, before its latents are found.

    `prior`: prior of the latents, widened if the markers require it; `factor`: factor on its covariance by which it was
    widened; `noise` (n_obs, n_obs): C_d, the tracker's noise and the model's own errors at the markers, mm^2; `near`
    (n_latent,): most probable latents of a linear model, at which these errors are taken.
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
    """Return prior and noise of a moment, from draws of the model's prior.

    `model`: the model of the moment; `seen` int64 (n_seen,): markers that are used; `latents`, `predicted` (n_latent,
    n_members) and (3 n_seen, n_members): draws from the prior, and their predictions of these markers, mm; `centre` (3
    n_seen,): predictions at the prior's mean, mm; `typical`: take the errors of a typical event rather than those at
    the latents of the linear model. Result: where no linear model can be fitted to the draws, the model's own prior and
    the errors at its mean.
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
    """Return C_d (3 n_seen, 3 n_seen), mm^2: the tracker's noise and the covariance of the model's errors.

    `errors` (n_fields, n_seen, 3): the model's errors at the markers with numbers `seen`, mm.
    """
    tracker = (markers.axis_std[seen] ** 2).ravel()
    return np.asarray(np.diag(tracker) + error_covariance(errors.reshape(len(errors), 3 * len(seen))))


@lru_cache
def _quantile(n_obs: int) -> float:
    """Return the 95 % quantile of the chi-square law with n_obs degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.isf(_LEVEL, n_obs))
