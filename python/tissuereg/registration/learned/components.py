r"""Kinds of events: the codes of a training set as a mixture of Gaussians.

A data set holds events of many kinds and sizes: a body that hangs, one that is pushed at a few places. Their codes
differ in size by orders of magnitude, so that one Gaussian is too wide for most of them and too narrow for a few. The
mixture

    p(z) = sum_k w_k N(z; m_k, C_k)

is fitted by expectation and maximisation (A. P. Dempster, N. M. Laird and D. B. Rubin, Journal of the Royal
Statistical Society B 39, 1-38, 1977).
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray

#: Rounds of sorting codes by their nearest centre, and of expectation and maximisation after it.
_SORTINGS, _ROUNDS = 20, 40

#: Codes by which the off-diagonal terms of a covariance are shrunk, as a share of the number of latents.
_SHRUNK = 0.3

#: A kind of fewer codes than this is left out: it is an outlier, not a kind.
_FEWEST = 20


@dataclass(frozen=True, eq=False)
class Components:
    """A mixture of Gaussians over latents, whose components are called kinds of events.

    `weights` (n_kinds,) are the probabilities of the components, which sum to one; `means` (n_kinds, n_latent) their
    means, dimensionless; `covariances` (n_kinds, n_latent, n_latent) their covariances, positive definite.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray

    @property
    def centre(self) -> FloatArray:
        """Mean of the codes of all kinds, (n_latent,)."""
        return np.asarray(self.weights @ self.means)

    @property
    def spread(self) -> FloatArray:
        """Standard deviation of the codes of all kinds, (n_latent,)."""
        variance = np.diagonal(self.covariances, axis1=1, axis2=2) + (self.means - self.centre) ** 2
        return np.asarray(np.sqrt(self.weights @ variance))

    @classmethod
    def fit(cls, codes: FloatArray, n_kinds: int, seed: int) -> "Components":
        """Return the Gaussian mixture of the latents of a training set; each component is called a kind of event.

        `codes` (n_codes, n_latent) are the means that the encoder gives the training fields; `n_kinds` is the number of
        components at the start, of which those that keep too few codes are left out; `seed` determines the start. Cost:
        40 rounds of n_kinds products (n_latent, n_codes).
        """
        shares = _sorted_by_direction_and_size(codes, n_kinds, np.random.default_rng([seed, 21]))
        kinds = cls._of(codes, shares)
        for _ in range(_ROUNDS):
            kinds = cls._of(codes, kinds.shares(codes))
        return kinds

    @classmethod
    def _of(cls, codes: FloatArray, shares: FloatArray) -> "Components":
        """Return the mixture of Gaussians that is fitted to codes with given probabilities of its components.

        `codes` has shape (n_codes, n_latent); `shares` (n_codes, n_kinds) is the probability that each code belongs to
        each component. Components with too few codes are left out.
        """
        n_latent = codes.shape[1]
        counts = shares.sum(axis=0)
        # The largest stays, however few the codes.
        kept = counts >= min(_FEWEST, counts.max())
        shares, counts = shares[:, kept], counts[kept]
        means = (shares.T @ codes) / counts[:, None]
        covariances = np.empty((len(counts), n_latent, n_latent))
        for k, count in enumerate(counts):
            away = codes - means[k]
            covariance = (away * shares[:, k : k + 1]).T @ away / count
            keep = 1.0 / (1.0 + _SHRUNK * n_latent / count)
            floor = 1e-6 * np.trace(covariance) / n_latent + 1e-12
            diagonal = (1.0 - keep) * np.diag(covariance) + floor
            covariances[k] = keep * covariance + np.diag(diagonal)
        return cls(counts / counts.sum(), means, covariances)

    def log_densities(self, codes: FloatArray) -> FloatArray:
        """Return the logarithm of w_k N(z; m_k, C_k), without its constant, for each code z and component k.

        `codes` has shape (n_codes, n_latent), the result (n_codes, n_kinds); w_k, m_k and C_k are weight, mean and
        covariance of component k.
        """
        found = np.empty((len(codes), len(self.weights)))
        for k, (weight, mean, covariance) in enumerate(zip(self.weights, self.means, self.covariances, strict=True)):
            root = np.linalg.cholesky(covariance)
            white = np.linalg.solve(root, (codes - mean).T)
            found[:, k] = np.log(weight) - np.log(np.diag(root)).sum() - 0.5 * (white**2).sum(axis=0)
        return found

    def shares(self, codes: FloatArray) -> FloatArray:
        """Return the probability (n_codes, n_kinds) that each code (n_codes, n_latent) belongs to each component."""
        return probabilities(self.log_densities(codes))


def probabilities(logs: FloatArray) -> FloatArray:
    """Return numbers in proportion to exp(logs), of the shape of `logs`, that sum to one over the last axis."""
    raised = np.exp(logs - logs.max(axis=-1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def _sorted_by_direction_and_size(codes: FloatArray, n_kinds: int, rng: np.random.Generator) -> FloatArray:
    """Return a first assignment of codes (n_codes, n_latent) to components, by k-means on their direction and length.

    The result (n_codes, n_kinds) has a one in each row, in the column of the component, and zeros otherwise.
    """
    length = np.linalg.norm(codes, axis=1)
    size = np.log(length + 1e-9)
    features = 1.5 * np.column_stack([(size - size.mean()) / (size.std() + 1e-12), codes / (length + 1e-12)[:, None]])
    centres = features[rng.choice(len(codes), min(n_kinds, len(codes)), replace=False)]
    nearest = np.zeros(len(codes), np.int64)
    for _ in range(_SORTINGS):
        nearest = ((features[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
        for k in np.unique(nearest):
            centres[k] = features[nearest == k].mean(axis=0)
    return np.asarray(np.eye(len(centres))[nearest])
