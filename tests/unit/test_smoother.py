"""ES-MDA under a mixture: the closed form of a linear decoder is its oracle."""

import numpy as np
import pytest

from support.mixtures import closed_form, decoder
from tissuereg.errors import EnsembleError
from tissuereg.registration.learned.mixture import Component, LinearDecoder
from tissuereg.registration.learned.smoother import Screening, normals, smooth
from tissuereg.registration.settings import SmootherSettings

N_LATENT, N_OBS, N_ROWS = 4, 12, 18
ALPHAS = SmootherSettings(n_steps=4).alphas()


@pytest.fixture
def problem():
    """Return a mixture of two components with three scales, a linear decoder, markers and their noise."""
    rng = np.random.default_rng(1)

    def component(weight):
        root, errors = rng.standard_normal((N_LATENT, N_LATENT)), rng.standard_normal((N_ROWS, 2 * N_ROWS))
        covariance = root @ root.T + 0.3 * np.eye(N_LATENT)
        scales = np.array([0.4, 1.0, 2.0])
        return Component(
            weight * np.array([0.5, 0.3, 0.2]),
            scales,
            rng.standard_normal(N_LATENT),
            covariance,
            0.02 * errors @ errors.T,
        )

    linear = LinearDecoder(np.zeros(N_LATENT), rng.standard_normal(N_ROWS), rng.standard_normal((N_ROWS, N_LATENT)))
    return [component(0.6), component(0.4)], linear, 2.0 * rng.standard_normal(N_OBS), 0.09 * np.eye(N_OBS)


def test_with_a_linear_decoder_the_answer_is_the_closed_form(problem):
    prior, linear, observed, noise = problem
    every = np.arange(6)
    found = smooth(decoder(linear), prior, every, observed, noise, normals(0, N_LATENT, 30), ALPHAS)
    oracle = closed_form(prior, linear, observed, noise)
    np.testing.assert_allclose(found.weights, oracle.weights, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.mean, oracle.mean, atol=1e-8)
    np.testing.assert_allclose(found.mean_latents, oracle.mean_latents, atol=1e-8)
    np.testing.assert_allclose(found.covariance, oracle.covariance, atol=1e-8)
    for pair, mean, covariance, pull in zip(found.pairs, oracle.means, oracle.covariances, oracle.pulls, strict=True):
        np.testing.assert_allclose(pair.mean, mean, atol=1e-9)
        np.testing.assert_allclose(pair.covariance, covariance, atol=1e-9)
        np.testing.assert_allclose(pair.pulls.mean(axis=0), pull, atol=1e-8)


def test_the_screening_of_a_linear_decoder_has_its_evidence_and_keeps_the_likely_pairs(problem):
    prior, linear, observed, noise = problem
    found = Screening.of(decoder(linear), prior, observed, noise, np.full(N_LATENT, 3.0), np.ones(N_LATENT))
    oracle = closed_form(prior, linear, observed, noise)
    scored = found.found.pairs
    np.testing.assert_allclose(
        found.found.logs - found.found.logs.max(), oracle.logs[scored] - oracle.logs.max(), atol=1e-7
    )
    # What cannot count about a point near is not scored again.
    assert set(scored) == set(np.flatnonzero(oracle.logs > oracle.logs.max() + np.log(1e-12)))
    assert 0 < len(scored) < len(oracle.logs)
    kept = found.kept()
    assert (np.diff(oracle.logs[kept]) <= 0).all()
    assert set(kept) == set(np.flatnonzero(oracle.logs > oracle.logs.max() + np.log(1e-3)))


def test_a_decoder_that_bends_is_followed_by_the_steps():
    # One latent, y = exp(z): the posterior by quadrature.
    one = Component(np.ones(1), np.ones(1), np.zeros(1), np.eye(1), 1e-4 * np.eye(3))
    noise, observed = 0.04 * np.eye(3), np.full(3, 4.0)

    def decode(latents):
        return np.repeat(np.exp(latents.T), 3, axis=1)

    z = np.linspace(-4.0, 4.0, 20_001)
    log = -0.5 * z**2 - 0.5 * 3 * (4.0 - np.exp(z)) ** 2 / (0.04 + 1e-4)
    weight = np.exp(log - log.max())
    mean = weight @ z / weight.sum()
    off = {}
    for n_steps in (1, 5):
        alphas = SmootherSettings(n_steps=n_steps).alphas()
        found = smooth(decode, [one], np.zeros(1, int), observed, noise, normals(0, 1, 60), alphas)
        off[n_steps] = abs(found.mean_latents[0] - mean)
    # The linear update alone overshoots; so many steps come within a few hundredths.
    assert off[5] < 0.05 < off[1]


def test_members_that_fail_are_named_and_too_few_of_them_raise(problem):
    prior, linear, observed, noise = problem
    whole = decoder(linear)

    def failing(share):
        def decode(latents):
            rows = whole(latents)
            rows[: int(share * len(rows))] = np.nan
            return rows

        return decode

    found = smooth(failing(0.1), prior[:1], np.zeros(1, int), observed, noise, normals(0, N_LATENT, 40), (1.0,))
    assert [index for index, _ in found.dropped][:4] == [0, 1, 2, 3]
    assert np.isfinite(found.mean).all()
    with pytest.raises(EnsembleError, match="at least half of 40"):
        smooth(failing(0.6), prior[:1], np.zeros(1, int), observed, noise, normals(0, N_LATENT, 40), (1.0,))


def test_few_members_state_wider_covariances(problem):
    prior, linear, observed, noise = problem
    few, many = (
        np.mean(
            [
                np.trace(
                    smooth(
                        decoder(linear), prior[:1], np.array([1]), observed, noise, normals(seed, N_LATENT, n), ALPHAS
                    ).covariance
                )
                for seed in range(200)
            ]
        )
        for n in (5, 60)
    )
    exact = np.trace(
        closed_form(
            [Component(np.ones(1), np.ones(1), prior[0].mean, prior[0].covariance, prior[0].errors)],
            linear,
            observed,
            noise,
        ).covariance
    )
    assert many == pytest.approx(exact, rel=1e-6)
    assert few > 0.8 * exact
