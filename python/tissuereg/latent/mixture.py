r"""Bayes' rule for a decoder that is linear about a point, under a mixture of Gaussians.

Component c says that the latents are N(m_c, s P_c) and the model's own error at markers and targets is N(0, s E_c),
with s one of a few squared scales: events of a kind differ in size. With G and T the derivatives of markers and
targets by latents, and C_d the tracker's noise,

    S = s (G P_c G' + E_c[markers, markers]) + C_d,      v = y - g(m_c),
    targets | y, c, s  ~  N( t(m_c) + K v, ... ),        K = s (T P_c G' + E_c[targets, markers]) S^-1.

The error at the targets is learnt from the residual at the markers as far as the two are correlated. A component's
probability is its own times N(v; 0, S). Over scales and components the posterior is a mixture; its first two moments
are reported.
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.errors import NoiseError
from tissuereg.latent.kinds import probabilities

#: Pairs of component and scale that are less probable than this share of the most probable one are left out.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, eq=False)
class Component:
    """One component of a prior at markers and targets.

    Attributes
    ----------
    weights : ndarray of float64, shape (n_scales,)
        Probability of the component with each scale.
    scales : ndarray of float64, shape (n_scales,)
        Factors on standard deviations.
    mean : ndarray of float64, shape (n_latent,)
        Dimensionless.
    covariance : ndarray of float64, shape (n_latent, n_latent)
        At scale one.
    errors : ndarray of float64, shape (n_rows, n_rows)
        Covariance of the model's own error at scale one, mm^2; rows are components of markers, then of targets.
    """

    weights: FloatArray
    scales: FloatArray
    mean: FloatArray
    covariance: FloatArray
    errors: FloatArray


@dataclass(frozen=True, eq=False)
class Linear:
    """A decoder about a point: ``rows(z) = at + slopes (z - point)``, rows as in `Component.errors`, mm."""

    point: FloatArray
    at: FloatArray
    slopes: FloatArray


@dataclass(frozen=True, eq=False)
class MixturePosterior:
    """A mixture over pairs of component and scale; rows as in `Component.errors`.

    Attributes
    ----------
    weights : ndarray of float64, shape (n_pairs,)
        Sum to one.
    component, scale : ndarray of shape (n_pairs,)
        Number of the component, and its scale.
    latents : ndarray of float64, shape (n_pairs, n_latent)
        Means.
    means : ndarray of float64, shape (n_pairs, n_rows)
        Means of the displacement of markers and targets, the model's own error included, mm.
    covariances : ndarray of float64, shape (n_pairs, n_rows, n_rows)
        mm^2.
    pulls : ndarray of float64, shape (n_pairs, n_obs)
        S^-1 v, 1/mm.
    p_value : float
        Chance of an innovation as improbable as this one, averaged over the pairs.
    """

    weights: FloatArray
    component: FloatArray
    scale: FloatArray
    latents: FloatArray
    means: FloatArray
    covariances: FloatArray
    pulls: FloatArray
    p_value: float

    @property
    def mean(self) -> FloatArray:
        """Mean displacement (n_rows,) of markers and targets, mm."""
        return np.asarray(self.weights @ self.means)

    @property
    def mean_latents(self) -> FloatArray:
        """Mean of the latents (n_latent,)."""
        return np.asarray(self.weights @ self.latents)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n_rows, n_rows) of the mixture, mm^2."""
        away = (self.means - self.mean) * np.sqrt(self.weights)[:, None]
        return np.asarray(np.tensordot(self.weights, self.covariances, 1) + away.T @ away)


def condition(prior: list[Component], model: Linear, observed: FloatArray, noise: FloatArray) -> MixturePosterior:
    """Return the posterior of markers and targets given the markers.

    Parameters
    ----------
    prior : list of Component
        The mixture.
    model : Linear
        Decoder at markers and targets.
    observed : ndarray of float64, shape (n_obs,)
        Measured displacements, mm; the first n_obs rows of the model.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance of the tracker's noise, mm^2.

    Returns
    -------
    MixturePosterior
        Cost: a Cholesky factor of size n_obs for every pair of component and scale.

    Raises
    ------
    NoiseError
        If the covariance of an innovation is not positive definite.
    """
    from scipy.linalg import lapack
    from scipy.stats import chi2

    n_obs = len(observed)
    slopes = model.slopes
    found = []
    for number, one in enumerate(prior):
        spread = slopes @ one.covariance
        own = spread @ slopes.T + one.errors
        off = observed - model.at[:n_obs] - slopes[:n_obs] @ (one.mean - model.point)
        for weight, scale in zip(one.weights, one.scales, strict=True):
            factor, pull, square, log = _innovation(off, scale**2 * own[:n_obs, :n_obs] + noise)
            found.append((np.log(weight) + log, number, scale, pull, square, factor, spread, own))
    logs = np.array([one[0] for one in found])
    kept = np.flatnonzero(logs > logs.max() + np.log(_NEGLIGIBLE))
    weights = probabilities(logs[kept])
    latents, means, covariances = [], [], []
    for _, number, scale, pull, _, factor, spread, own in (found[i] for i in kept):
        one = prior[number]
        latents.append(one.mean + scale**2 * spread[:n_obs].T @ pull)
        means.append(
            model.at + slopes @ (one.mean - model.point) + scale**2 * own[:, :n_obs] @ pull,
        )
        half = lapack.dtrtrs(factor, scale**2 * own[:n_obs], lower=1)[0]
        covariances.append(scale**2 * own - half.T @ half)
    squares = np.array([found[i][4] for i in kept])
    return MixturePosterior(
        weights,
        np.array([found[i][1] for i in kept]),
        np.array([found[i][2] for i in kept]),
        np.array(latents),
        np.array(means),
        np.array(covariances),
        np.array([found[i][3] for i in kept]),
        float(weights @ chi2.sf(squares, n_obs)),
    )


def log_evidence(prior: list[Component], model: Linear, observed: FloatArray, noise: FloatArray) -> FloatArray:
    """Return log N(v; 0, S), (n_components, n_scales), without weights and constant; arguments as for `condition`."""
    n_obs = len(observed)
    seen = model.slopes[:n_obs]
    logs = np.empty((len(prior), len(prior[0].scales)))
    for c, one in enumerate(prior):
        own = seen @ one.covariance @ seen.T + one.errors[:n_obs, :n_obs]
        off = observed - model.at[:n_obs] - seen @ (one.mean - model.point)
        for s, scale in enumerate(one.scales):
            logs[c, s] = _innovation(off, scale**2 * own + noise)[3]
    return logs


def _innovation(off: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Return the Cholesky factor of S, S^-1 v, v' S^-1 v, and log N(v; 0, S) without its constant."""
    from scipy.linalg import lapack

    factor, fails = lapack.dpotrf(covariance, lower=1)
    if fails:
        message = "the covariance of the innovation must be positive definite"
        raise NoiseError(message, where="noise")
    pull = lapack.dpotrs(factor, off, lower=1)[0].ravel()
    square = float(off @ pull)
    return factor, pull, square, -0.5 * square - float(np.log(factor.diagonal()).sum())
