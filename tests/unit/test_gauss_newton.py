"""Gauss-Newton with a Laplace covariance: exact where the model is linear, honest where it bends."""

import numpy as np
import pytest
from scipy.stats import chi2

from tissuereg import _core
from tissuereg.errors import ArgumentError, ConvergenceError, EnsembleError, NoiseError, ShapeError
from tissuereg.registration.learned.assimilate import SearchSettings, gauss_newton
from tissuereg.registration.learned.model import Gaussian


def linear_problem(seed, n_latent=6, n_obs=9):
    rng = np.random.default_rng(seed)
    operator = rng.standard_normal((n_obs, n_latent))
    root = rng.standard_normal((n_latent, n_latent))
    prior = Gaussian(rng.standard_normal(n_latent), root @ root.T + np.eye(n_latent))
    factor = rng.standard_normal((n_obs, n_obs))
    noise = 0.05 * factor @ factor.T + 0.1 * np.eye(n_obs)
    observed = operator @ rng.standard_normal(n_latent)
    gain = prior.covariance @ operator.T @ np.linalg.inv(operator @ prior.covariance @ operator.T + noise)
    mean = prior.mean + gain @ (observed - operator @ prior.mean)
    covariance = prior.covariance - gain @ operator @ prior.covariance
    return operator, prior, noise, observed, mean, covariance


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_linear_model_gives_the_kalman_posterior(seed):
    operator, prior, noise, observed, mean, covariance = linear_problem(seed)
    found = gauss_newton(lambda z: operator @ z, observed, noise, prior, jacobian=lambda z: operator)
    # Rounding of the reference, which inverts matrices of condition up to 1e3.
    np.testing.assert_allclose(found.mean, mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.covariance, covariance, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.absorbed, operator @ covariance @ operator.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.predicted, operator @ mean, rtol=0, atol=1e-11)
    innovation = observed - operator @ prior.mean
    whole = innovation @ np.linalg.solve(operator @ prior.covariance @ operator.T + noise, innovation)
    assert found.misfit == pytest.approx(whole, rel=1e-10)
    assert (found.iterations, found.evaluations) == (1, 2)


def test_differences_in_one_call_an_iteration_give_it_too():
    operator, prior, noise, observed, mean, covariance = linear_problem(3)
    widths = []

    def predict(latents):
        widths.append(latents.shape[1])
        return operator @ latents

    found = gauss_newton(predict, observed, noise, prior)
    # A difference over 2e-4 standard deviations leaves 1e-12 of rounding.
    np.testing.assert_allclose(found.mean, mean, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-9)
    assert widths == [13] * found.evaluations


def test_a_model_in_single_precision_converges_with_wide_differences():
    toy = Toy()
    rng = np.random.default_rng(5)
    observed = toy.predict(rng.standard_normal((12, 1)))[:, 0] + 0.2 * rng.standard_normal(30)
    exact = gauss_newton(toy.predict, observed, toy.noise, toy.prior, settings=SearchSettings(tolerance=1e-8))
    single = gauss_newton(
        lambda z: toy.predict(z.astype(np.float32)).astype(np.float32),
        observed,
        toy.noise,
        toy.prior,
        settings=SearchSettings(difference=1e-2),
    )
    # The tolerance of 1e-3 standard deviations, which are 0.1 to 1 here.
    np.testing.assert_allclose(single.mean, exact.mean, atol=2e-3)
    np.testing.assert_allclose(single.covariance, exact.covariance, atol=2e-3)


def test_draws_have_the_moments_of_the_posterior():
    operator, prior, noise, observed, _, _ = linear_problem(4)
    found = gauss_newton(lambda z: operator @ z, observed, noise, prior)
    draws = found.draws(np.random.default_rng(0), 50)
    # Balanced draws leave rounding.
    np.testing.assert_allclose(draws.mean(axis=1), found.mean, atol=1e-12)
    np.testing.assert_allclose(np.cov(draws), found.covariance, atol=1e-12)
    assert np.array_equal(draws, found.draws(np.random.default_rng(0), 50))
    few = found.ensemble(np.random.default_rng(0), 3)
    assert few.latents.shape == (6, 3)
    assert (few.exact_draws, few.dropped) == (False, [])


class Toy:
    """Predictions that bend: a quadratic of 0.3 on a linear part of one, noise 0.2; targets of the same kind."""

    n_latent, n_obs, n_targets, std = 12, 30, 3, 0.2

    def __init__(self):
        rng = np.random.default_rng(0)
        shape = (self.n_obs + self.n_targets, self.n_latent)
        self.straight, self.bent = rng.standard_normal((2, *shape)) / np.sqrt(self.n_latent)
        self.noise = self.std**2 * np.eye(self.n_obs)
        self.prior = Gaussian(np.zeros(self.n_latent), np.eye(self.n_latent))

    def all(self, latents):
        return self.straight @ latents + 0.3 * (self.bent @ latents) ** 2

    def predict(self, latents):
        return np.ascontiguousarray(self.all(latents)[: self.n_obs])

    def targets(self, latents):
        return self.all(latents)[self.n_obs :]

    def jacobian(self, latents):
        slopes = self.straight + 0.6 * (self.bent @ latents)[:, None] * self.bent
        return slopes[: self.n_obs]

    def ensemble(self, observed, rng, form):
        noise = _core.Noise.diagonal(np.full(self.n_obs, self.std))
        latents = rng.standard_normal((self.n_latent, 100))
        for alpha in _core.schedule_geometric(5, 2.0):
            predicted = self.predict(latents)
            if form == "stochastic":
                draws = rng.standard_normal(predicted.shape)
                step = _core.Step(predicted, observed, noise, draws, alpha=alpha, threads=1)
            else:
                step = _core.Step.square_root(predicted, observed, noise, alpha=alpha, threads=1)
            latents = step.apply(np.ascontiguousarray(latents))
        return latents


def test_differences_in_one_batch_are_the_jacobian():
    toy = Toy()
    rng = np.random.default_rng(6)
    observed = toy.predict(rng.standard_normal((12, 1)))[:, 0] + 0.2 * rng.standard_normal(30)
    arguments = (toy.predict, observed, toy.noise, toy.prior)
    given = gauss_newton(*arguments, jacobian=toy.jacobian, settings=SearchSettings(tolerance=1e-9))
    by_differences = gauss_newton(*arguments, settings=SearchSettings(tolerance=1e-9))
    # Central differences of a quadratic are exact: rounding over 2e-4 is left.
    np.testing.assert_allclose(by_differences.absorbed, given.absorbed, atol=1e-10)
    np.testing.assert_allclose(by_differences.mean, given.mean, atol=1e-8)


def test_the_start_decides_where_the_search_begins_not_where_it_ends():
    toy = Toy()
    rng = np.random.default_rng(7)
    truth = rng.standard_normal((12, 1))
    observed = toy.predict(truth)[:, 0] + 0.2 * rng.standard_normal(30)
    arguments = (toy.predict, observed, toy.noise, toy.prior)
    cold = gauss_newton(*arguments, settings=SearchSettings(tolerance=1e-8))
    warm = gauss_newton(*arguments, start=cold.mean, settings=SearchSettings(tolerance=1e-8))
    assert warm.iterations == 0 < cold.iterations
    other = gauss_newton(*arguments, start=truth[:, 0], settings=SearchSettings(tolerance=1e-8))
    # Steps below 1e-8 standard deviations converge linearly at worst by a half.
    np.testing.assert_allclose(other.mean, cold.mean, atol=1e-7)


def test_ninety_percent_regions_at_targets_hold_ninety_percent_and_more_than_those_of_a_stochastic_ensemble():
    toy = Toy()
    held = {"laplace": 0, "stochastic": 0, "square root": 0}
    n_runs = 800
    for run in range(n_runs):
        rng = np.random.default_rng([1, run])
        truth = rng.standard_normal((12, 1))
        observed = toy.predict(truth)[:, 0] + toy.std * rng.standard_normal(30)
        wanted = toy.targets(truth)[:, 0]
        posterior = gauss_newton(toy.predict, observed, toy.noise, toy.prior)
        members = {
            "laplace": posterior.draws(rng, 100),
            "stochastic": toy.ensemble(observed, rng, "stochastic"),
            "square root": toy.ensemble(observed, rng, "square root"),
        }
        for name, latents in members.items():
            fields = toy.targets(latents)
            off = wanted - fields.mean(axis=1)
            held[name] += off @ np.linalg.solve(np.cov(fields), off) <= chi2.isf(0.1, 3)
    share = {name: count / n_runs for name, count in held.items()}
    # A share of 0.9 in 800 runs has a standard deviation of 0.011.
    assert 0.86 <= share["laplace"] <= 0.94, share
    assert 0.86 <= share["square root"] <= 0.94, share
    # The same truths and noise: a hundred members with plain draws lose spread.
    assert share["stochastic"] < share["laplace"] - 0.02, share


def bent_by_one(failing=lambda z: np.zeros(z.shape, bool)):
    """Exponential of one latent, NaN where `failing` says so."""
    return lambda z: np.where(failing(z), np.nan, np.exp(z))


ONE = Gaussian(np.zeros(1), np.eye(1))


def test_a_model_that_fails_at_the_start_raises():
    with pytest.raises(EnsembleError, match="`predicted` must be finite, got NaN at row 0"):
        gauss_newton(bent_by_one(lambda z: z == 0.0), np.array([3.0]), np.eye(1), ONE)
    with pytest.raises(EnsembleError, match="must stay within 1e4 in absolute value, got 1e19"):
        gauss_newton(lambda z: np.full(z.shape, 1e19), np.array([3.0]), np.eye(1), ONE)


def test_points_where_the_model_fails_are_stepped_back_from():
    # The first step goes to 1.98, beyond what the model can do.
    limited = bent_by_one(lambda z: z > 1.3)
    found = gauss_newton(limited, np.array([3.0]), 0.01 * np.eye(1), ONE)
    assert found.evaluations > found.iterations + 1
    free = gauss_newton(bent_by_one(), np.array([3.0]), 0.01 * np.eye(1), ONE)
    # Both end within 1e-3 of a standard deviation of 0.03.
    np.testing.assert_allclose(found.mean, free.mean, atol=1e-4)


def test_a_failed_neighbour_leaves_a_one_sided_derivative_and_is_told():
    two = Gaussian(np.zeros(2), np.eye(2))
    fails = lambda z: np.where(z[1] > 1e-9, np.nan, z)  # noqa: E731
    found = gauss_newton(fails, np.array([1.0, -1e-12]), np.eye(2), two)
    assert found.one_sided == (1,)
    # A difference to one side of a linear model is exact too, but for the rounding.
    np.testing.assert_allclose(found.covariance, 0.5 * np.eye(2), atol=1e-10)
    with pytest.raises(EnsembleError, match="along prior direction 0; it fails on both"):
        gauss_newton(bent_by_one(lambda z: z != 0.0), np.array([1.0]), np.eye(1), ONE)


def test_a_search_without_a_minimum_raises_with_its_report():
    with pytest.raises(ConvergenceError, match="no minimum was found in 9 evaluations") as caught:
        gauss_newton(
            lambda z: z,
            np.array([1.0]),
            0.01 * np.eye(1),
            ONE,
            jacobian=lambda z: -np.eye(1),
            settings=SearchSettings(max_evaluations=9),
        )
    report = caught.value.report
    assert report["evaluations"] == 9
    # (d - y) / sigma = 10 with a slope of 10: 100 / sqrt(101).
    assert report["last_step"] == pytest.approx(9.950371902099892)


def test_noise_may_be_factored_already():
    given = (lambda z: 2.0 * z, np.array([1.0]))
    dense, made = (
        gauss_newton(*given, noise, ONE) for noise in (0.04 * np.eye(1), _core.Noise.diagonal(np.array([0.2])))
    )
    # 0.2^2 is 0.04 but for the rounding.
    np.testing.assert_allclose(made.mean, dense.mean, rtol=1e-12)
    np.testing.assert_allclose(made.covariance, dense.covariance, rtol=1e-12)


@pytest.mark.parametrize(
    ("error", "match", "change"),
    [
        (NoiseError, "positive definite", {"noise": -np.eye(1)}),
        (ShapeError, r"`noise` must have shape \(2, 2\)", {"observed": np.ones(2)}),
        (ArgumentError, "prior covariance must be positive definite", {"prior": Gaussian(np.zeros(1), -np.eye(1))}),
        (ArgumentError, "`mean` must be finite", {"prior": Gaussian(np.full(1, np.nan), np.eye(1))}),
        (ArgumentError, "`tolerance` must be a finite number greater than 0", {"tolerance": 0.0}),
        (ArgumentError, "`difference` must be a finite number greater than 0", {"difference": -1.0}),
        (ArgumentError, "`max_evaluations` must be a whole number of at least 1", {"max_evaluations": 0}),
        (ShapeError, r"`start` must have shape \(1,\)", {"start": np.zeros(2)}),
        (
            ShapeError,
            r"`predict\(latents\)` must have shape \(1, 3\), got \(2, 3\)",
            {"predict": lambda z: np.ones((2, 3))},
        ),
        (ShapeError, r"`jacobian\(latents\)` must have shape \(1, 1\)", {"jacobian": lambda z: np.ones((1, 2))}),
    ],
)
def test_wrong_arguments_are_named(error, match, change):
    given = {"predict": lambda z: z, "observed": np.ones(1), "noise": np.eye(1), "prior": ONE}
    settings = {name: value for name, value in change.items() if name in ("tolerance", "difference", "max_evaluations")}
    data = {name: value for name, value in change.items() if name not in settings}
    with pytest.raises(error, match=match):
        gauss_newton(**given | data, settings=SearchSettings(**settings))
