"""The ES-MDA loop against the answer that is known where the model is linear."""

import numpy as np
import pytest

from tissuereg.assimilate import assimilate, balanced_draws
from tissuereg.errors import EnsembleError
from tissuereg.latent.model import Gaussian


def linear_problem(rng, n_latent=6, n_obs=9):
    operator = rng.standard_normal((n_obs, n_latent))
    root = rng.standard_normal((n_latent, n_latent))
    prior = Gaussian(rng.standard_normal(n_latent), root @ root.T + np.eye(n_latent))
    noise = np.diag(rng.uniform(0.05, 0.5, n_obs))
    observed = operator @ rng.standard_normal(n_latent)
    gain = prior.covariance @ operator.T @ np.linalg.inv(operator @ prior.covariance @ operator.T + noise)
    mean = prior.mean + gain @ (observed - operator @ prior.mean)
    covariance = prior.covariance - gain @ operator @ prior.covariance
    return operator, prior, noise, observed, mean, covariance


@pytest.mark.parametrize("n_steps", [1, 5])
def test_a_linear_model_gives_the_kalman_posterior(n_steps):
    operator, prior, noise, observed, mean, covariance = linear_problem(np.random.default_rng(3))
    found = assimilate(
        lambda z: operator @ z, observed, noise, prior, rng=np.random.default_rng(0), n_members=60, n_steps=n_steps
    )
    assert found.exact_draws
    # Balanced draws leave rounding only, amplified by the conditioning of C_yy.
    np.testing.assert_allclose(found.mean, mean, atol=1e-9)
    np.testing.assert_allclose(np.cov(found.latents), covariance, atol=1e-9)


def test_plain_draws_are_used_and_reported_where_the_ensemble_is_small():
    operator, prior, noise, observed, _, _ = linear_problem(np.random.default_rng(4))
    found = assimilate(
        lambda z: operator @ z, observed, noise, prior, rng=np.random.default_rng(0), n_members=12, min_members=5
    )
    assert not found.exact_draws
    assert found.spread_factor > 1.2


def test_the_same_generator_gives_the_same_bits_at_any_thread_count():
    operator, prior, noise, observed, _, _ = linear_problem(np.random.default_rng(5))
    runs = [
        assimilate(lambda z: operator @ z, observed, noise, prior, rng=np.random.default_rng(1), threads=threads)
        for threads in (1, 2)
    ]
    assert np.array_equal(runs[0].latents, runs[1].latents)


def test_failed_members_are_dropped_by_their_first_index_with_a_reason():
    operator, prior, noise, observed, mean, _ = linear_problem(np.random.default_rng(6))
    calls = []

    def predict(latents):
        predicted = operator @ latents
        if not calls:
            predicted[0, 7] = np.nan
            predicted[2, 31] = 1e19
        calls.append(latents.shape[1])
        return predicted

    found = assimilate(predict, observed, noise, prior, rng=np.random.default_rng(0), n_members=80)
    assert [index for index, _ in found.dropped] == [7, 31]
    assert calls == [80, 78, 78, 78, 78]
    assert np.abs(found.mean - mean).max() < 0.5


def test_too_few_survivors_raise_and_list_the_lost():
    _, prior, noise, observed, _, _ = linear_problem(np.random.default_rng(7))
    with pytest.raises(EnsembleError, match="at least 20 ensemble members must survive, 0 of 50") as caught:
        assimilate(
            lambda z: np.full((9, z.shape[1]), np.nan),
            observed,
            noise,
            prior,
            rng=np.random.default_rng(0),
            n_members=50,
        )
    assert len(caught.value.dropped) == 50


def test_balanced_draws_have_exact_moments_and_no_correlation():
    rng = np.random.default_rng(8)
    anomalies = rng.standard_normal((5, 40))
    anomalies -= anomalies.mean(axis=1, keepdims=True)
    draws, exact = balanced_draws(rng, (12, 40), anomalies)
    assert exact
    np.testing.assert_allclose(draws.mean(axis=1), 0.0, atol=1e-13)
    np.testing.assert_allclose(draws @ draws.T / 39, np.eye(12), atol=1e-12)
    np.testing.assert_allclose(draws @ anomalies.T, 0.0, atol=1e-11)
