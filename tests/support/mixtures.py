"""Bayes' rule for a linear decoder under a mixture of Gaussians, written as plainly as its formulas: an oracle."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

from tissuereg.registration.learned.mixture import Component, LinearDecoder


@dataclass
class Closed:
    """Posterior of every pair of component and scale.

    Probabilities, latents (n_pairs, n_latent), means (n_pairs, n_rows) and covariances (n_pairs, n_rows, n_rows) of the
    rows, pulls S^-1 v (n_pairs, n_obs), log evidence (n_pairs,).
    """

    weights: np.ndarray
    latents: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    pulls: np.ndarray
    logs: np.ndarray

    @property
    def mean(self):
        return self.weights @ self.means

    @property
    def mean_latents(self):
        return self.weights @ self.latents

    @property
    def covariance(self):
        away = self.means - self.mean
        return sum(
            weight * (one + np.outer(off, off))
            for weight, one, off in zip(self.weights, self.covariances, away, strict=True)
        )


def closed_form(prior: list[Component], model: LinearDecoder, observed: np.ndarray, noise: np.ndarray) -> Closed:
    """Return the posterior; the first rows of the decoder are observed."""
    n_obs, rows = len(observed), []
    for one in prior:
        for weight, scale in zip(one.weights, one.scales, strict=True):
            covariance, errors = scale**2 * one.covariance, scale**2 * one.errors
            joint = model.slopes @ covariance @ model.slopes.T + errors
            total = joint[:n_obs, :n_obs] + noise
            mean = model.at + model.slopes @ (one.mean - model.point)
            pull = np.linalg.solve(total, observed - mean[:n_obs])
            rows.append(
                (
                    np.log(weight) + multivariate_normal(mean[:n_obs], total).logpdf(observed),
                    one.mean + covariance @ model.slopes[:n_obs].T @ pull,
                    mean + joint[:, :n_obs] @ pull,
                    joint - joint[:, :n_obs] @ np.linalg.solve(total, joint[:n_obs]),
                    pull,
                )
            )
    logs, latents, means, covariances, pulls = (np.array(part) for part in zip(*rows, strict=True))
    weights = np.exp(logs - logs.max())
    return Closed(weights / weights.sum(), latents, means, covariances, pulls, logs)


def decoder(model: LinearDecoder):
    """Return a linear decoder as a function of latents (n_latent, n_columns)."""
    return lambda latents: model.at + (model.slopes @ (latents - model.point[:, None])).T
