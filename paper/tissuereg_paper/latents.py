"""What methods of the literature believe of latents: one Gaussian, and one covariance of the decoder's errors.

The package's own registration takes mixtures, of which trial registrations or the model itself say how probable they
are. Methods with one ensemble have one prior: about a simulation it is the encoder's q(z | simulation), widened by what
the model's card states of truths and their simulations.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.io.fields import open_npz
from tissuereg.registration.learned.card import read_card
from tissuereg.registration.learned.digits import table_in
from tissuereg.registration.learned.model import Gaussian, LatentModel, rms_displacement
from tissuereg.registration.learned.network import NetworkModel

#: Least size of a simulated event, mm: a tiny one does not make the truth certain.
_LEAST_SIZE_MM = 0.3

#: No prior is widened beyond this factor on its covariance.
_MOST = 400.0

#: Significance level at which an innovation is too large for the prior.
_LEVEL = 0.05


def error_covariance(rows: FloatArray) -> FloatArray:
    """Return the covariance of reconstruction errors about zero.

    Parameters
    ----------
    rows : ndarray of float64, shape (n_fields, n_components)
        Errors in mm, one row a field.

    Returns
    -------
    ndarray of float64, shape (n_components, n_components)
        mm^2; not centred, so that a constant error is included.

    Notes
    -----
    With fewer fields than components the sample covariance is singular, and spurious correlations would let the data
    cancel the error. Off-diagonal terms are shrunk by the weight of Ledoit and Wolf's target for a sample of this size,
    ``1 / (1 + n_components / n_fields)``; the diagonal is kept.
    """
    if len(rows) == 0:
        return np.zeros((rows.shape[1], rows.shape[1]))
    covariance = rows.T @ rows / len(rows)
    keep = 1.0 / (1.0 + rows.shape[1] / len(rows))
    return np.asarray(keep * covariance + (1.0 - keep) * np.diag(np.diag(covariance)))


def prior_of(model: LatentModel, simulation_mm: FloatArray | None) -> Gaussian:
    """Return the prior of the latents of a moment.

    Parameters
    ----------
    model : LatentModel
        A network has an encoder; the prior of any other model does not depend on the simulation.
    simulation_mm : ndarray of float64, shape (n_nodes, 3), or None
        Simulated displacement, mm; None for the distribution of all training codes.

    Returns
    -------
    Gaussian
        About the code of the simulation, with the encoder's variance plus the covariance of encoder(truth) -
        encoder(simulation) on the model's card, in proportion to the size of the simulated event where that is known.
    """
    if simulation_mm is None or not isinstance(model, NetworkModel):
        return model.prior()
    known = read_card(model.folder)["prior"]
    mean, variance = model.encode(simulation_mm)
    relative = known.get("relative_mismatch_covariance")
    if relative is None:
        return Gaussian(mean, np.diag(variance) + np.asarray(known["mismatch_covariance"], np.float64))
    size = max(float(rms_displacement(simulation_mm[None])[0]), _LEAST_SIZE_MM)
    return Gaussian(mean, np.diag(variance) + size**2 * np.asarray(relative, np.float64))


def errors_of(model: LatentModel, *, simulated: bool) -> FloatArray:
    """Return errors (n_fields, n_nodes, 3), mm, of a model, of whole fields or of differences from a simulation.

    Parameters
    ----------
    model : LatentModel
        Only a network tells the two apart, if there were pairs of simulation and truth beside its training data.
    simulated : bool
        Whether the model describes differences from a simulation.

    Returns
    -------
    ndarray of float64, shape (n_fields, n_nodes, 3)
        Errors of fields not used in training; they are those of typical events, whatever the size of this one.
    """
    if simulated and isinstance(model, NetworkModel):
        with open_npz(model.folder / "decoder_weights.npz") as weights:
            changes = table_in(weights, "change_error_fields_mm", None, model.n_nodes, 3)
        if len(changes):
            return changes
    return model.errors()


@dataclass(frozen=True, eq=False)
class LinearPredictions:
    """Predictions at the markers as a linear function of the latents: ``centre + slope (z - mean of the prior)``.

    Attributes
    ----------
    centre : ndarray of float64, shape (n_obs,)
        Predictions at the mean, mm.
    slope : ndarray of float64, shape (n_obs, n_latent)
        Derivatives, mm.
    """

    centre: FloatArray
    slope: FloatArray

    @classmethod
    def of(
        cls, prior: Gaussian, latents: FloatArray, predicted: FloatArray, centre: FloatArray
    ) -> "LinearPredictions | None":
        """Return the regression of predictions on latents drawn from the prior.

        Parameters
        ----------
        prior : Gaussian
            From which the latents are drawn.
        latents : ndarray of float64, shape (n_latent, n_members)
            The draws.
        predicted : ndarray of float64, shape (n_obs, n_members)
            Their predictions, mm; members that are not finite are left out.
        centre : ndarray of float64, shape (n_obs,)
            Predictions at the prior's mean, mm.

        Returns
        -------
        LinearPredictions or None
            None if too few members are finite.
        """
        whole = np.isfinite(predicted).all(axis=0)
        if whole.sum() <= len(prior.mean) or not np.isfinite(centre).all():
            return None
        root = np.linalg.cholesky(prior.covariance)
        draws = np.linalg.solve(root, latents[:, whole] - prior.mean[:, None])
        moments = np.linalg.solve(draws @ draws.T, draws @ (predicted[:, whole] - centre[:, None]).T)
        return cls(centre, np.linalg.solve(root.T, moments).T)


def widened(
    prior: Gaussian, family: Gaussian, linear: LinearPredictions, observed: FloatArray, noise: FloatArray
) -> tuple[Gaussian, float]:
    """Return the prior, widened if the innovation is too large for it.

    Parameters
    ----------
    prior : Gaussian
        Of the latents.
    family : Gaussian
        Distribution of the codes of all training fields, beyond whose spread no direction is widened.
    linear : LinearPredictions
        About the prior's mean.
    observed : ndarray of float64, shape (n_obs,)
        Measured displacements of the markers, mm.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance C_d, mm^2.

    Returns
    -------
    prior : Gaussian
        With the same mean and the covariance ``C(s) = ((s C)^-1 + L^-1)^-1``, with the prior's C and the family's L;
        the given one if s = 1.
    factor : float
        The smallest s >= 1 with ``v' (H C(s) H' + C_d)^-1 v = n_obs`` for the innovation v and the slope H, if ``s =
        1`` exceeds the 95 % quantile of its chi-square law; 1 otherwise, and at most 400.

    Notes
    -----
    The maximum-likelihood inflation of data assimilation, J. L. Anderson, "An adaptive covariance inflation error
    correction algorithm for ensemble filters", Tellus A 59, 210-224, 2007, with one factor for the whole prior.
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
    enough = misfit(covariance(_MOST)) <= n_obs
    factor = float(brentq(lambda s: misfit(covariance(s)) - n_obs, 1.0, _MOST)) if enough else _MOST
    return Gaussian(prior.mean, covariance(factor)), factor


@lru_cache
def _quantile(n_obs: int) -> float:
    """Return the 95 % quantile of the chi-square law with n_obs degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.isf(_LEVEL, n_obs))
