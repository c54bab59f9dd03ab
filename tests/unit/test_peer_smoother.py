"""Equivalence: the update against iterative_ensemble_smoother's, given the same noise and no truncation."""

import numpy as np
import pytest

from tissuereg import _core

peer = pytest.importorskip("iterative_ensemble_smoother", reason="a development dependency")


def problem(n_latent, n_obs, n_members, std):
    rng = np.random.default_rng(n_obs)
    latents = rng.standard_normal((n_latent, n_members))
    operator = rng.standard_normal((n_obs, n_latent)) / np.sqrt(n_latent)
    correlation = 0.5 ** np.abs(np.subtract.outer(np.arange(n_obs), np.arange(n_obs)))
    scales = std * rng.uniform(0.5, 2.0, n_obs)
    covariance = correlation * np.outer(scales, scales)
    # Not linear, so that the ensembles of later steps differ from the first one's shape.
    return latents, lambda z: np.sin(operator @ z), operator @ rng.standard_normal(n_latent), covariance, rng


@pytest.mark.parametrize(("n_latent", "n_obs", "n_members"), [(26, 45, 100), (26, 120, 60), (200, 9, 30)])
@pytest.mark.parametrize("std", [0.3, 0.01])
def test_a_run_of_four_steps_is_that_of_iterative_ensemble_smoother(n_latent, n_obs, n_members, std):
    ours, predict, observed, covariance, rng = problem(n_latent, n_obs, n_members, std)
    theirs = ours.copy()
    alphas = [28.0 / 3.0, 7.0, 4.0, 2.0]
    smoother = peer.ESMDA(covariance, observed, alpha=np.array(alphas), seed=1)
    noise, root = _core.Noise.dense(covariance), np.linalg.cholesky(covariance)
    for alpha in alphas:
        draws = rng.standard_normal((n_obs, n_members))
        ours = _core.Step(predict(ours), observed, noise, draws, alpha=alpha).apply(ours)
        smoother.prepare_assimilation(Y=predict(theirs), truncation=1.0, observation_perturbations=root @ draws)
        theirs = smoother.assimilate_batch(X=theirs)
    # Four steps on predictions up to a hundred standard deviations apart lose four of sixteen digits.
    assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()
