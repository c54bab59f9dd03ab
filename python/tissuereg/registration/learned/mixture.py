r"""Which Gaussian of a mixture prior the markers speak for, by a decoder that is linear about a point.

Component c of the prior says that the latents are N(m_c, s^2 P_c) and that the model's own error at markers and targets
is N(0, s^2 E_c), where s is one of a few scales, because events differ in size. With the derivative G of the
displacement g of the markers by the latents, the measured displacement y, and the covariance R of the tracker's noise,
the innovation of a pair of component and scale is

    v = y - g(m_c) ~ N(0, S),      S = s^2 (G P_c G' + E_c[markers, markers]) + R.

The posterior probability of a pair is in proportion to its prior probability times N(v; 0, S), and the mean of its
latents is ``m_c + s^2 P_c G' S^-1 v``.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.registration.learned.components import probabilities
from tissuereg.registration.trust import NOISE_FACTORS

#: Pairs of component and scale that are less probable than this share of the most probable one are left out of a mean.
_NEGLIGIBLE = 1e-4

#: Share of the most probable pair below which another linearisation makes no pair count.
HOPELESS = 1e-12


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
class Evidence:
    """What the markers say of pairs of component and scale; the scales of a component are adjacent.

    `prior`, `model`: of which mixture, and by which decoder; `pairs` int64 (n_pairs,): numbers of the pairs among all;
    `component` int64 and `scale` (n_pairs,): of each pair; `weights` (n_pairs,): logarithm of its prior probability;
    `innovations`: S - R at scale one (k, n_obs, n_obs) and v (k, n_obs) of the k components in use, the number of each
    pair's among them, and its scale;
    `logs` (n_pairs,): logarithm of prior probability times N(v; 0, S), up to a common constant; `pulls` (n_pairs,
    n_obs): S^-1 v, 1/mm; `misfits`, `log_dets` (n_pairs, n_markers): squared distance of each marker from its
    prediction by the others, in the prediction's standard deviations, and log det of the marker's block of S^-1, for
    the markers that were asked for.
    """

    prior: list[Component]
    model: LinearDecoder
    pairs: IntArray
    component: IntArray
    scale: FloatArray
    weights: FloatArray
    innovations: tuple[FloatArray, FloatArray, IntArray, FloatArray]
    logs: FloatArray
    pulls: FloatArray
    misfits: FloatArray
    log_dets: FloatArray

    @classmethod
    def of(
        cls,
        prior: list[Component],
        model: LinearDecoder,
        observed: FloatArray,
        noise: FloatArray,
        *,
        compared: Literal["none", "every", "last"] = "none",
        pairs: IntArray | None = None,
    ) -> "Evidence":
        """Return the evidence of pairs.

        `observed` (n_obs,): measured displacements, mm, of the decoder's first n_obs rows; `noise` (n_obs, n_obs):
        covariance of the tracker's noise, mm^2; `compared`: markers that are compared with their prediction by the
        others; `pairs` int64 (n_pairs,), ascending: numbers of the pairs, all by default. Raises
        `NoiseError` if the covariance of an innovation is not positive definite. Cost: a Cholesky factor of size n_obs
        for every pair, and an inverse where every marker is compared.
        """
        n_obs = len(observed)
        slopes = model.slopes[:n_obs]
        component = np.repeat(np.arange(len(prior)), [len(one.scales) for one in prior])
        pairs = np.arange(len(component)) if pairs is None else pairs
        component, scale = component[pairs], np.concatenate([one.scales for one in prior])[pairs]
        with np.errstate(divide="ignore"):
            weights = np.log(np.concatenate([one.weights for one in prior])[pairs])
        needed, number = np.unique(component, return_inverse=True)
        used = [prior[c] for c in needed]
        spread = slopes @ np.array([one.covariance for one in used]) @ slopes.T
        covariances = spread + np.array([one.errors[:n_obs, :n_obs] for one in used])
        off = observed - model.at[:n_obs] - (np.array([one.mean for one in used]) - model.point) @ slopes.T
        given, group = (covariances, off, number, scale), 0 if compared == "none" else 3
        noise = np.ascontiguousarray(noise)
        logs, *others = _core.score_components(*given, noise, group=group, last=compared == "last", threads=1)
        return cls(prior, model, pairs, component, scale, weights, given, weights + logs, *others)

    @cached_property
    def mean_latents(self) -> FloatArray:
        """Posterior mean (n_latent,) of the latents, dimensionless."""
        kept = np.flatnonzero(self.logs >= self.logs.max() + np.log(_NEGLIGIBLE))
        weights = probabilities(self.logs[kept])
        across = self.pulls[kept] @ self.model.slopes[: self.pulls.shape[1]]
        pairs = zip(weights, self.component[kept], self.scale[kept], across, strict=True)
        means = [w * (self.prior[c].mean + s**2 * self.prior[c].covariance @ one) for w, c, s, one in pairs]
        return np.asarray(np.sum(means, axis=0))

    @property
    def likely(self) -> IntArray:
        """Numbers (k,) of the pairs that are probable enough to count if the decoder is linear about another point."""
        return np.asarray(self.pairs[self.logs >= self.logs.max() + np.log(HOPELESS)])

    @property
    def of_components(self) -> FloatArray:
        """Logarithm of the evidence of each component, over these scales, up to a constant, (n_components,)."""
        logs = np.full(len(self.prior), -np.inf)
        np.logaddexp.at(logs, self.component, self.logs)
        return logs

    def chances(self) -> tuple[FloatArray, FloatArray]:
        """Return how well each marker agrees with the prediction from all other markers.

        The first result (n_markers,) is its squared distance from the prediction, in the prediction's standard
        deviations, averaged over the pairs; the second (n_markers,) the probability of one at least as large. Every
        pair predicts the marker, weighted by its probability given the *other* markers: a wrong marker has no say in
        which kind of event explains the rest.
        """
        from scipy.special import chdtrc

        # The density of the others is that of all, over the marker's given the others.
        weights = probabilities((self.logs[:, None] + 0.5 * self.misfits - 0.5 * self.log_dets).T).T
        return (weights * self.misfits).sum(axis=0), (weights * chdtrc(3, self.misfits)).sum(axis=0)


def log_noise_odds(stated: Evidence, noise: FloatArray) -> float:
    """Return by how much the markers speak for larger noise than stated: the largest log ratio of evidences.

    `stated`: evidence under the stated covariance `noise` (n_obs, n_obs), mm^2, with which covariances are compared
    that are `NOISE_FACTORS`^2 times as large. Negative where the stated one explains the markers best. Cost: a Cholesky
    factor of size n_obs for every pair and factor.
    """
    larger = (
        stated.weights + _core.score_components(*stated.innovations, f**2 * noise, threads=1)[0] for f in NOISE_FACTORS
    )
    return float(max(map(np.logaddexp.reduce, larger)) - np.logaddexp.reduce(stated.logs))
