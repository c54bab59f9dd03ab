"""The linear algebra of evidence and proof, against dense Gaussian densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from tissuereg.diagnosis.evidence import Blocks, Null, fit_amplitudes, log_mean_exp, probabilities
from tissuereg.diagnosis.nulls import _thresholds
from tissuereg.diagnosis.proof import LinearModel, held_out
from tissuereg.diagnosis.settings import DEFAULT

SIZE = 30


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def density(x, covariance):
    return multivariate_normal(np.zeros(len(x)), covariance).logpdf(x)


def test_reducing_is_the_inverse_root_of_the_null_covariance(rng):
    nuisances = rng.standard_normal((4, SIZE))
    null, x, y = Null(nuisances), rng.standard_normal(SIZE), rng.standard_normal(SIZE)
    covariance = np.eye(SIZE) + nuisances.T @ nuisances
    assert null.reduced(x) @ null.reduced(y) == pytest.approx(x @ np.linalg.solve(covariance, y), rel=1e-10)


def test_no_nuisance_changes_nothing(rng):
    x = rng.standard_normal((2, SIZE))
    assert np.array_equal(Null(np.zeros((0, SIZE))).reduced(x), x)


def test_the_log_bayes_factor_is_the_difference_of_two_log_densities(rng):
    nuisances, columns = rng.standard_normal((3, SIZE)), rng.standard_normal((2, SIZE))
    null, x = Null(nuisances), 2.0 * rng.standard_normal(SIZE)
    c0 = np.eye(SIZE) + nuisances.T @ nuisances
    found, _ = fit_amplitudes(null.reduced(x), null.reduced(columns))
    assert found == pytest.approx(density(x, c0 + columns.T @ columns) - density(x, c0), rel=1e-9)


def test_a_positive_amplitude_has_half_the_prior(rng):
    column, x = rng.standard_normal((1, SIZE)), rng.standard_normal(SIZE)
    amplitudes = np.linspace(0.0, 8.0, 20_001)
    likelihood = np.array([norm.logpdf(x - a * column[0]).sum() for a in amplitudes])
    logs = likelihood + norm.logpdf(amplitudes) + np.log(2.0)
    integral = np.log(np.trapezoid(np.exp(logs - logs.max()), amplitudes)) + logs.max()
    found = Blocks(column[None], positive=True).log_bayes_factors(x[None])
    assert found[0, 0] == pytest.approx(integral - norm.logpdf(x).sum(), abs=1e-6)


@pytest.mark.parametrize("p", [1, 3])
def test_many_hypotheses_at_once_are_what_each_is_alone(rng, p):
    columns, residuals = rng.standard_normal((5, p, SIZE)), rng.standard_normal((4, SIZE))
    together = Blocks(columns).log_bayes_factors(residuals)
    alone = [[fit_amplitudes(r, c)[0] for c in columns] for r in residuals]
    assert np.allclose(together, alone, atol=1e-4)  # the many are kept in single precision


def test_many_positive_amplitudes_at_once_are_what_each_is_alone(rng):
    columns, residuals = rng.standard_normal((5, 1, SIZE)), rng.standard_normal((4, SIZE))
    together = Blocks(columns, positive=True).log_bayes_factors(residuals)
    alone = [[Blocks(c[None], positive=True).log_bayes_factors(r[None])[0, 0] for c in columns] for r in residuals]
    assert np.allclose(together, alone, atol=1e-4)


def test_log_mean_exp_survives_large_numbers():
    assert log_mean_exp(np.array([1000.0, 1000.0 + np.log(3.0)])) == pytest.approx(1000.0 + np.log(2.0))


def test_probabilities_hold_none_and_sum_to_one():
    found = probabilities({"a": 3.0, "b": -800.0})
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["a"] / found[""] == pytest.approx(np.exp(3.0 / DEFAULT.evidence.temper))


def test_a_held_out_block_is_predicted_by_the_conditional_gaussian(rng):
    columns, x = rng.standard_normal((4, SIZE)), 2.0 * rng.standard_normal(SIZE)
    mask = np.zeros(SIZE, bool)
    mask[10:18] = True
    covariance = np.eye(SIZE) + columns.T @ columns
    gain = covariance[np.ix_(mask, ~mask)] @ np.linalg.inv(covariance[np.ix_(~mask, ~mask)])
    mean = gain @ x[~mask]
    inner = covariance[np.ix_(mask, mask)] - gain @ covariance[np.ix_(~mask, mask)]
    found = held_out([LinearModel(x, columns)], {"block": mask})
    assert np.allclose(found.residuals[0, mask], x[mask] - mean)
    assert np.isnan(found.residuals[0, ~mask]).all()
    constant = 0.5 * mask.sum() * np.log(2.0 * np.pi)
    assert found.log_density[0, 0] == pytest.approx(density(x[mask] - mean, inner) + constant, rel=1e-9)


def test_thresholds_share_the_false_alarms_and_are_highest_for_causes_that_null_draws_resemble(rng):
    n = 500
    mesh = rng.standard_exponential(n)
    # Two causes follow the error of the mesh, one the noise alone.
    drawn = {"gain": 5.0 * mesh, "layer": 2.0 * mesh, "latency": rng.standard_exponential(n) - 2.0}
    limits = _thresholds(drawn)
    assert limits["latency"] == DEFAULT.nulls.least_threshold
    assert limits["gain"] > 2.0 * limits["layer"] > 2.0 * DEFAULT.nulls.least_threshold
    alarms = np.any([drawn[name] > limits[name] for name in drawn], axis=0)
    # The two pass together, so that neither pays for the other.
    assert 0.5 * DEFAULT.nulls.level < alarms.mean() <= DEFAULT.nulls.level
