r"""Bayes' rule for a decoder that is linear about a point, under a prior that is a mixture of Gaussians.

Component c of the prior says that the latents are N(m_c, s P_c) and that the model's own error at markers and targets
is N(0, s E_c), where s is one of a few squared scales, because events differ in size. With the derivatives G and T of
the displacement g of markers and t of targets by the latents, the measured displacement y, and the covariance C_d of
the tracker's noise,

    S = s (G P_c G' + E_c[markers, markers]) + C_d,      v = y - g(m_c),
    targets | y, c, s  ~  N( t(m_c) + K v, ... ),        K = s (T P_c G' + E_c[targets, markers]) S^-1.

The error at the targets is estimated from the residual at the markers as far as the two are correlated. The posterior
probability of a component with a scale is in proportion to its prior probability times N(v; 0, S). Over scales and
components the posterior is a mixture; its first two moments are reported.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import NoiseError
from tissuereg.registration.learned.components import probabilities

#: Pairs of component and scale that are less probable than this share of the most probable one are left out.
_NEGLIGIBLE = 1e-4

#: Standard deviations of the tracker's noise over the stated ones, with which the stated ones are compared.
NOISE_FACTORS = (3.0, 10.0)

#: Those less probable than this share stay so when the decoder is linearised anew close by.
_HOPELESS = 1e-12


@dataclass(frozen=True, eq=False)
class Component:
    """One component of a Gaussian mixture prior of latents, with the model's own error at markers and targets.

    `weights` (n_scales,) is the probability of the component with each scale; `scales` (n_scales,) are factors on its
    standard deviations; `mean` (n_latent,) is its mean, dimensionless; `covariance` (n_latent, n_latent) is its
    covariance at scale one; `errors` (n_rows, n_rows) is the covariance of the model's own error at scale one, in mm^2,
    where rows are displacement components of the markers, then of the targets.
    """

    weights: FloatArray
    scales: FloatArray
    mean: FloatArray
    covariance: FloatArray
    errors: FloatArray


@dataclass(frozen=True, eq=False)
class LinearDecoder:
    """A decoder linearised about a point in latent space: ``rows(z) = at + slopes (z - point)``.

    The rows are displacement components of the markers, then of the targets. `point` (n_latent,) is the point,
    dimensionless; `at` (n_rows,) is the displacement there, in mm; `slopes` (n_rows, n_latent) are derivatives by the
    latents, in mm.
    """

    point: FloatArray
    at: FloatArray
    slopes: FloatArray


@dataclass(frozen=True, eq=False)
class MixturePosterior:
    """The posterior under a linear decoder: one Gaussian for each pair of component and scale of the prior.

    Rows are displacement components of markers, then of targets.

    Attributes
    ----------
    weights : ndarray of float64, shape (n_pairs,)
        Probability of each pair; they sum to one.
    component : ndarray of int64, shape (n_pairs,)
        Number of the pair's component.
    scale : ndarray of float64, shape (n_pairs,)
        Factor on the standard deviations of that component.
    latents : ndarray of float64, shape (n_pairs, n_latent)
        Means of the latents.
    means : ndarray of float64, shape (n_pairs, n_rows)
        Means of the displacement, the model's own error included, mm.
    covariances : ndarray of float64, shape (n_pairs, n_rows, n_rows)
        Covariances of the displacement, mm^2.
    pulls : ndarray of float64, shape (n_pairs, n_obs)
        S^-1 v, 1/mm.
    logs : ndarray of float64, shape (n_all,)
        Logarithm of each pair's probability times the density of the innovation, up to a constant, for all pairs of the
        prior, component by component. Pairs that were ruled out about an earlier point have their value there.
    log_evidence : ndarray of float64, shape (n_components,)
        Logarithm of the evidence of each component, summed over its scales.
    """

    weights: FloatArray
    component: IntArray
    scale: FloatArray
    latents: FloatArray
    means: FloatArray
    covariances: FloatArray
    pulls: FloatArray
    logs: FloatArray
    log_evidence: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Posterior mean (n_rows,) of the displacement components of markers, then targets, in mm."""
        return np.asarray(self.weights @ self.means)

    @property
    def mean_latents(self) -> FloatArray:
        """Posterior mean (n_latent,) of the latents, dimensionless."""
        return np.asarray(self.weights @ self.latents)

    @property
    def covariance(self) -> FloatArray:
        """Posterior covariance (n_rows, n_rows) of the displacement components of markers, then targets, in mm^2."""
        away = (self.means - self.mean) * np.sqrt(self.weights)[:, None]
        return np.asarray(np.tensordot(self.weights, self.covariances, 1) + away.T @ away)


class Conditioned:
    """A mixture prior conditioned on the markers with a linear decoder: probabilities of its pairs, and their latents.

    A pair is a component of the prior with one of its scales (factors on its standard deviations). `prior` holds the
    components; `model` is the decoder at markers and targets; `observed` (n_obs,) are the measured displacements, in
    mm, of the first n_obs rows of the model; `noise` (n_obs, n_obs) is the covariance of the tracker's noise, in mm^2;
    `earlier` (n_all,) are the `logs` of all pairs with the decoder linearised about a point close by: pairs that are
    far too improbable there are ruled out. Raises `NoiseError` if the covariance of an innovation is not positive
    definite.

    The attributes `weights` (n_pairs,), `latents` (n_pairs, n_latent) and `pulls` (n_pairs, n_obs), in 1/mm, are the
    posterior probabilities, mean latents and S^-1 v of the pairs that are kept, where v is the innovation and S its
    covariance; `logs` (n_all,) is the logarithm of prior probability times density of v for all pairs, up to a
    constant.

    Notes
    -----
    Cost: a Cholesky factor of size n_obs + 1 for every pair of component and scale.
    """

    def __init__(
        self,
        prior: list[Component],
        model: LinearDecoder,
        observed: FloatArray,
        noise: FloatArray,
        earlier: FloatArray | None = None,
    ) -> None:
        self._prior, self._model, self._n_obs = prior, model, len(observed)
        weights = np.concatenate([one.weights for one in prior])
        self.logs = np.full(len(weights), -np.inf) if earlier is None else earlier.copy()
        considered = np.flatnonzero(weights > 0.0 if earlier is None else earlier > earlier.max() + np.log(_HOPELESS))
        self._innovations = found = _innovations(prior, model, observed, noise, considered)
        self.logs[considered] = logs = np.log(weights[considered]) + found.logs
        self._kept = np.flatnonzero(logs > logs.max() + np.log(_NEGLIGIBLE))
        self.weights = probabilities(logs[self._kept])
        self.pulls = np.array([self._backwards(pair) for pair in self._kept])
        self.latents = np.array(
            [
                prior[found.component[pair]].mean
                + found.scale[pair] ** 2 * found.parts[found.component[pair]][0][: self._n_obs].T @ pull
                for pair, pull in zip(self._kept, self.pulls, strict=True)
            ]
        )

    @property
    def mean_latents(self) -> FloatArray:
        """Posterior mean (n_latent,) of the latents, dimensionless."""
        return np.asarray(self.weights @ self.latents)

    @property
    def log_evidence(self) -> FloatArray:
        """Logarithm of the evidence of each component, over its scales, up to a constant, (n_components,)."""
        ends = np.cumsum([len(one.weights) for one in self._prior])[:-1]
        return np.array([np.logaddexp.reduce(part) for part in np.split(self.logs, ends)])

    def posterior(self) -> MixturePosterior:
        """Return the posterior displacement of markers and targets, without pairs of negligible probability."""
        from scipy.linalg import lapack

        n_obs, model, found, kept = self._n_obs, self._model, self._innovations, self._kept
        means, covariances = [], []
        for pair, pull in zip(kept, self.pulls, strict=True):
            one, scale = self._prior[found.component[pair]], found.scale[pair]
            _, own = found.parts[found.component[pair]]
            means.append(model.at + model.slopes @ (one.mean - model.point) + scale**2 * own[:, :n_obs] @ pull)
            half = lapack.dtrtrs(found.factors[pair, :n_obs, :n_obs], scale**2 * own[:n_obs], lower=1)[0]
            covariances.append(scale**2 * own - half.T @ half)
        return MixturePosterior(
            self.weights,
            found.component[kept],
            found.scale[kept],
            self.latents,
            np.array(means),
            np.array(covariances),
            self.pulls,
            self.logs,
            self.log_evidence,
        )

    def _backwards(self, pair: Any) -> FloatArray:
        """Return S^-1 v (n_obs,), in 1/mm, of the pair with this number: v is its innovation, S the covariance of v."""
        from scipy.linalg import lapack

        factor = self._innovations.factors[pair]
        return np.asarray(lapack.dtrtrs(factor[:-1, :-1], factor[-1, :-1], lower=1, trans=1)[0])


def condition(
    prior: list[Component], model: LinearDecoder, observed: FloatArray, noise: FloatArray
) -> MixturePosterior:
    """Return the posterior displacement of markers and targets given the measured markers, under a linear decoder.

    `prior` holds the components of a Gaussian mixture; `model` is the decoder at markers and targets; `observed`
    (n_obs,) are the measured displacements, in mm, of the decoder's first n_obs rows; `noise` (n_obs, n_obs) is the
    covariance of the tracker's noise, in mm^2. Raises `NoiseError` if the covariance of an innovation is not positive
    definite.
    """
    return Conditioned(prior, model, observed, noise).posterior()


@dataclass(frozen=True, eq=False)
class LeftOut:
    """How well each marker agrees with the prediction from all other markers.

    `misfits` (n_markers,): squared distance of the marker from its prediction, in standard deviations of the
    prediction, averaged over the pairs; `chances` (n_markers,): probability of a distance at least as large.
    """

    misfits: FloatArray
    chances: FloatArray


def left_out(prior: list[Component], model: LinearDecoder, observed: FloatArray, noise: FloatArray) -> LeftOut:
    """Return how well each marker agrees with the prediction from all other markers.

    Every pair of component and scale predicts the marker, weighted by its probability given the *other* markers: a
    wrong marker has no say in which kind of event explains the rest. With u = S^-1 v and A the marker's 3 x 3 block of
    S^-1, the squared distance under a pair is u' A^-1 u, and the density of the others is that of all markers divided
    by N(0; A^-1 u, A^-1). Arguments and errors as for `Conditioned`; n_obs = 3 n_markers. Cost: a Cholesky factor of
    size n_obs + 1 and its inverse for every pair.
    """
    from scipy.linalg import lapack
    from scipy.special import chdtrc

    found, n_obs = _innovations(prior, model, observed, noise), len(observed)
    with np.errstate(divide="ignore"):
        logs = np.log(np.concatenate([one.weights for one in prior])) + found.logs
    roots = np.array([lapack.dtrtri(factor[:n_obs, :n_obs], lower=1)[0] for factor in found.factors])
    pulls = np.einsum("poi,po->pi", roots, found.factors[:, n_obs, :n_obs]).reshape(len(roots), -1, 3)
    columns = roots.reshape(len(roots), n_obs, n_obs // 3, 3).transpose(0, 2, 3, 1)
    blocks = columns @ columns.transpose(0, 1, 3, 2)
    misfits = (pulls * np.linalg.solve(blocks, pulls[..., None])[..., 0]).sum(axis=2)
    weights = probabilities((logs[:, None] + 0.5 * misfits - 0.5 * np.linalg.slogdet(blocks)[1]).T).T
    return LeftOut((weights * misfits).sum(axis=0), (weights * chdtrc(3, misfits)).sum(axis=0))


def log_noise_odds(prior: list[Component], model: LinearDecoder, observed: FloatArray, noise: FloatArray) -> float:
    """Return by how much the markers speak for larger noise than stated: the largest log ratio of evidences.

    Compared are the evidence under the stated covariance and under covariances that are `NOISE_FACTORS`^2 times as
    large; negative where the stated one explains the markers best. Arguments and errors as for `Conditioned`. Cost: a
    Cholesky factor of size n_obs + 1 for every pair and factor.
    """
    with np.errstate(divide="ignore"):
        weights = np.log(np.concatenate([one.weights for one in prior]))
    stated, *larger = (
        np.logaddexp.reduce(weights + _innovations(prior, model, observed, factor**2 * noise).logs)
        for factor in (1.0, *NOISE_FACTORS)
    )
    return float(max(larger) - stated)


def log_evidence(prior: list[Component], model: LinearDecoder, observed: FloatArray, noise: FloatArray) -> FloatArray:
    """Return log N(v; 0, S) of every component and scale, (n_components, n_scales), up to a common constant.

    v is the innovation (measured minus predicted displacement of the markers) and S its covariance. `prior` holds the
    components; `model` is the decoder at markers and targets; `observed` (n_obs,) are the measured displacements, in
    mm; `noise` (n_obs, n_obs) is the covariance of the tracker's noise, in mm^2.
    """
    return _innovations(prior, model, observed, noise).logs.reshape(len(prior), -1)


@dataclass(frozen=True, eq=False)
class _Innovations:
    """Innovations v and their covariances S for pairs of component and scale; the scales of a component are adjacent.

    `component`, `scale` (n_pairs,): number of the component, and its scale; `parts`: g P, and G P G' + E at scale one,
    of the components in question, over all rows; `factors` (n_pairs, n_obs + 1, n_obs + 1): Cholesky factors L of S,
    with (L^-1 v)' as a last row; `logs` (n_pairs,): log N(v; 0, S) without its constant.
    """

    component: IntArray
    scale: FloatArray
    parts: dict[int, tuple[FloatArray, FloatArray]]
    factors: FloatArray
    logs: FloatArray


def _innovations(
    prior: list[Component], model: LinearDecoder, observed: FloatArray, noise: FloatArray, pairs: IntArray | None = None
) -> _Innovations:
    """Return the innovations (measured minus predicted displacement of the markers) for pairs of component and scale.

    `prior` holds the components; `model` is the decoder at markers and targets; `observed` (n_obs,) are the measured
    displacements, in mm; `noise` (n_obs, n_obs) is the covariance of the tracker's noise, in mm^2; `pairs` int64 are
    the numbers of the pairs, by default all. Raises `NoiseError` if a covariance of an innovation is not positive
    definite.
    """
    n_obs = len(observed)
    component = np.repeat(np.arange(len(prior)), [len(one.scales) for one in prior])
    scale = np.concatenate([one.scales for one in prior])
    if pairs is not None:
        component, scale = component[pairs], scale[pairs]
    found, of_pair = np.unique(component, return_inverse=True)
    parts = {}
    for number in found:
        spread = model.slopes @ prior[number].covariance
        parts[int(number)] = spread, spread @ model.slopes.T + prior[number].errors
    seen = np.array([own[:n_obs, :n_obs] for _, own in parts.values()])
    points = np.array([prior[number].mean for number in found]) - model.point
    off = observed - model.at[:n_obs] - points @ model.slopes[:n_obs].T
    # Bordered by v', one Cholesky factor gives log det S and L^-1 v; the corner only has to be large enough.
    bordered = np.zeros((len(scale), n_obs + 1, n_obs + 1))
    bordered[:, :n_obs, :n_obs] = (scale**2)[:, None, None] * seen[of_pair] + noise
    bordered[:, n_obs, :n_obs] = off[of_pair]
    try:
        largest = (off.T * np.linalg.solve(noise, off.T)).sum(axis=0)
        bordered[:, n_obs, n_obs] = 1.0 + 2.0 * largest[of_pair]
        factors = np.asarray(np.linalg.cholesky(bordered), np.float64)
    except np.linalg.LinAlgError as error:
        message = "the covariance of the innovation must be positive definite"
        raise NoiseError(message, where="noise") from error
    squares = (factors[:, n_obs, :n_obs] ** 2).sum(axis=1)
    logs = -0.5 * squares - np.log(np.diagonal(factors, axis1=1, axis2=2)[:, :n_obs]).sum(axis=1)
    return _Innovations(component, scale, parts, factors, logs)
