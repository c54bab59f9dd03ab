"""The ES-MDA loop against the answer that is known where the model is linear."""

import numpy as np
import pytest

from tissuereg import _core
from tissuereg.errors import ArgumentError, EnsembleError, ScheduleError, ShapeError
from tissuereg.registration.learned.draws import balanced_draws
from tissuereg.registration.learned.model import Gaussian
from tissuereg_paper.rivals.assimilation import (
    AssimilationSettings,
    StepOptions,
    assimilate,
)


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


def run(problem, seed=0, perturbations=None, **settings):
    """Return the ensemble of a linear problem."""
    operator, prior, noise, observed = problem[:4]
    rng, how = np.random.default_rng(seed), AssimilationSettings(**settings)
    return assimilate(
        lambda z: operator @ z, observed, noise, prior, rng=rng, settings=how, perturbations=perturbations
    )


def is_kalmans(found, problem):
    """Compare with the known posterior; balanced draws leave rounding, amplified by the conditioning of C_yy."""
    mean, covariance = problem[4:]
    np.testing.assert_allclose(found.mean, mean, atol=1e-9)
    np.testing.assert_allclose(np.cov(found.latents), covariance, atol=1e-9)


@pytest.mark.parametrize("n_steps", [1, 5])
def test_a_linear_model_gives_the_kalman_posterior(n_steps):
    problem = linear_problem(np.random.default_rng(3))
    found = run(problem, n_members=60, n_steps=n_steps)
    assert found.exact_draws
    is_kalmans(found, problem)


def test_plain_draws_are_used_and_reported_where_the_ensemble_is_small():
    found = run(linear_problem(np.random.default_rng(4)), n_members=12, min_members=5)
    assert not found.exact_draws
    assert found.spread_factor > 1.2


def test_the_same_generator_gives_the_same_bits_at_any_thread_count():
    problem = linear_problem(np.random.default_rng(5))
    runs = [run(problem, seed=1, threads=threads) for threads in (1, 2)]
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

    found = assimilate(
        predict, observed, noise, prior, rng=np.random.default_rng(0), settings=AssimilationSettings(n_members=80)
    )
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
            settings=AssimilationSettings(n_members=50),
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


@pytest.mark.parametrize("schedule", ["geometric", [28 / 3, 7, 4, 2]])
def test_any_schedule_gives_the_kalman_posterior_of_a_linear_model_and_closes_its_sum(schedule):
    problem = linear_problem(np.random.default_rng(3))
    found = run(problem, n_members=60, schedule=schedule)
    assert sum(1.0 / alpha for alpha in found.alphas) == pytest.approx(1.0, abs=1e-12)
    assert 1 < len(found.alphas) < 20
    is_kalmans(found, problem)


OPTIONS = {
    "square root": StepOptions(form="square_root"),
    "svd": StepOptions(factorisation="svd"),
    "qr": StepOptions(factorisation="qr"),
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS.keys())
def test_every_option_gives_the_kalman_posterior(options):
    problem = linear_problem(np.random.default_rng(3))
    is_kalmans(run(problem, n_members=60, options=options), problem)


def test_perturbations_of_the_caller_are_the_ones_used():
    problem, asked = linear_problem(np.random.default_rng(3)), []

    def perturbations(step, shape):
        asked.append((step, shape))
        return np.zeros(shape)

    found = run(problem, perturbations=perturbations, n_members=60, n_steps=3)
    assert asked == [(0, (9, 60)), (1, (9, 60)), (2, (9, 60))]
    assert not found.exact_draws
    # Without any perturbation every member is drawn to the same data: far less spread than the posterior's.
    posterior = run(problem, n_members=60)
    assert np.trace(np.cov(found.latents)) < 0.9 * np.trace(np.cov(posterior.latents))


def test_there_is_no_hidden_generator():
    problem = operator, prior, noise, observed, _, _ = linear_problem(np.random.default_rng(3))
    with pytest.raises(TypeError, match="rng"):
        assimilate(lambda z: operator @ z, observed, noise, prior)
    first, second = (run(problem, seed).latents for seed in (0, 1))
    assert not np.allclose(first, second)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"schedule": "adaptive"}, ScheduleError, "`schedule` must be one of geometric"),
        ({"schedule": [4.0, 2.0, 1.0]}, ScheduleError, "add up to 1 within 1e-9, got 1.75"),
        ({"n_steps": 0}, ScheduleError, "`n_steps` must be a whole number of at least 1"),
        (
            {"options": StepOptions(form="square_root"), "perturbations": lambda step, shape: np.zeros(shape)},
            ArgumentError,
            "`perturbations` must be None in the square-root form",
        ),
        ({"n_members": 1, "min_members": 0}, EnsembleError, "at least 2 ensemble members"),
        ({"noise": _core.Noise.diagonal(np.ones(4))}, ShapeError, "`noise` must be that of 9 observations, got 4"),
        ({"prior": Gaussian(np.zeros(6), np.zeros((6, 6)))}, ArgumentError, "`prior` must be positive definite"),
        (
            {"perturbations": lambda step, shape: np.zeros((2, 2))},
            ShapeError,
            r"`perturbations` must have shape \(9, 200\)",
        ),
    ],
)
def test_wrong_settings_of_a_run_are_refused(settings, error, message):
    settings = dict(settings)
    operator, prior, noise, observed, _, _ = linear_problem(np.random.default_rng(3))
    data = {name: settings.pop(name) for name in ("noise", "prior", "perturbations") if name in settings}
    given = {"noise": noise, "prior": prior, "rng": np.random.default_rng(0), **data}
    with pytest.raises(error, match=message):
        assimilate(lambda z: operator @ z, observed, **given, settings=AssimilationSettings(**settings))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"form": "etkf"}, "`form` must be one of stochastic, square_root"),
        ({"factorisation": "lu"}, "`factorisation` must be one of auto, cholesky, qr, svd"),
        ({"form": "square_root", "factorisation": "qr"}, "`factorisation` must be auto"),
    ],
)
def test_wrong_options_of_a_step_are_refused(settings, message):
    problem = linear_problem(np.random.default_rng(3))
    with pytest.raises((ArgumentError, ShapeError), match=message):
        run(problem, options=StepOptions(**settings))
