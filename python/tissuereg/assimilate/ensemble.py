"""The ES-MDA loop: draw, decode, compare, update; Algorithm 1 of the paper, lines 3 to 10.

`tissuereg-esmda` computes the update; random numbers are drawn here, from a generator that the caller passes in.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg import _core
from tissuereg._arrays import FloatArray
from tissuereg.errors import EnsembleError
from tissuereg.latent.model import Gaussian

#: A predicted marker displacement beyond this many mm marks a failed member.
ABSURD_MM = 1e4


@dataclass(frozen=True, eq=False)
class Assimilation:
    """A posterior ensemble of latents.

    Attributes
    ----------
    latents : ndarray of float64, shape (n_latent, n_members)
        Members that survived.
    predicted : ndarray of float64, shape (n_obs, n_members)
        Their predictions before the last update, mm.
    dropped : list of (int, str)
        Members that were lost, by their first index, with the reason.
    exact_draws : bool
        Whether draws were balanced, see `balanced_draws`; otherwise the spread of a small ensemble is too narrow.
    """

    latents: FloatArray
    dropped: list[tuple[int, str]]
    exact_draws: bool

    @property
    def mean(self) -> FloatArray:
        """Ensemble mean, shape (n_latent,)."""
        return np.asarray(self.latents.mean(axis=1))

    @property
    def spread_factor(self) -> float:
        """Factor on covariances that corrects for the finite ensemble.

        Mean and covariance estimated from n independent members predict a further draw with the covariance
        times ``(1 + 1/n)(n - 1)/(n - 3)`` (variance of Student's t); balanced draws estimate nothing.
        """
        n = self.latents.shape[1]
        return 1.0 if self.exact_draws else (1.0 + 1.0 / n) * (n - 1.0) / max(n - 3.0, 1.0)


def assimilate(
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray,
    prior: Gaussian,
    *,
    rng: np.random.Generator,
    n_members: int = 200,
    n_steps: int = 5,
    decrease: float = 2.0,
    min_members: int = 20,
    threads: int = 0,
) -> Assimilation:
    """Return the posterior ensemble of the latents given observations.

    Parameters
    ----------
    predict : callable
        Latents (n_latent, n_members) to predictions (n_obs, n_members) in mm.
    observed : ndarray of float64, shape (n_obs,)
        Measured marker displacements in mm.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance C_d of the measurement about a perfect model's prediction, mm^2.
    prior : Gaussian
        Prior of the latents.
    rng : numpy.random.Generator
        The only source of random numbers.
    n_members, n_steps : int
        Ensemble size N_e and number of assimilations N_a.
    decrease : float
        Each inflation coefficient over the next; their inverses sum to one.
    min_members : int
        Fewer surviving members than this raise.
    threads : int
        Threads of the update; the result does not depend on it.

    Returns
    -------
    Assimilation
        The ensemble after the last update.

    Raises
    ------
    EnsembleError
        If fewer than `min_members` members survive.
    NoiseError
        If `noise` is not positive definite.

    Notes
    -----
    ``z += C_zy (C_yy + a C_d)^-1 (d + sqrt(a) C_d^1/2 e - y)``, A. A. Emerick and A. C. Reynolds, "Ensemble smoother
    with multiple data assimilation", Computers & Geosciences 55, 3-15, 2013, doi:10.1016/j.cageo.2012.03.011.
    """
    covariance = _core.Noise.dense(noise)
    root = np.linalg.cholesky(prior.covariance)
    shape = (len(prior.mean), n_members)
    draws, balanced = balanced_draws(rng, shape, np.empty((0, n_members)))
    latents = prior.mean[:, None] + root @ draws
    members = np.arange(n_members)
    dropped: list[tuple[int, str]] = []
    for alpha in _core.schedule_geometric(n_steps, decrease):
        predicted = predict(latents)
        kept, lost = _core.screen_members(predicted, ABSURD_MM)
        dropped += [(int(members[index]), reason) for index, reason in lost]
        if len(kept) < max(min_members, 2):
            message = f"at least {min_members} ensemble members must survive, {len(kept)} of {n_members} are left"
            raise EnsembleError(message, dropped=dropped)
        members, latents, predicted = (
            members[kept],
            latents[:, kept],
            np.ascontiguousarray(predicted[:, kept]),
        )
        draws, exact = balanced_draws(rng, predicted.shape, latents - latents.mean(axis=1, keepdims=True))
        balanced &= exact
        step = _core.Step(predicted, observed, covariance, draws, alpha=float(alpha), threads=threads)
        latents = step.apply(np.ascontiguousarray(latents))
    return Assimilation(latents, dropped, balanced)


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
    basis, singular, _ = np.linalg.svd(taken.T, full_matrices=False)
    basis = basis[:, singular > 1e-12 * singular.max()]
    draws -= (draws @ basis) @ basis.T
    root = np.linalg.cholesky(draws @ draws.T / (n_members - 1))
    return np.ascontiguousarray(np.linalg.solve(root, draws)), True
