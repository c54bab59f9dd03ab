"""What methods of the literature believe of latents: priors about a simulation, and errors of a model."""

import numpy as np
import pytest

from support.small_model import SMALL_MODEL
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.card import read_card
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.pca import PcaModel
from tissuereg_paper.latents import LinearPredictions, error_covariance, errors_of, prior_of, widened


@pytest.fixture(scope="module")
def network():
    return NetworkModel(SMALL_MODEL, phantom_mesh("small"), threads=1)


def test_the_error_covariance_keeps_its_diagonal_and_is_positive_definite():
    rows = np.random.default_rng(2).standard_normal((8, 20)) + 0.5
    covariance = error_covariance(rows)
    np.testing.assert_allclose(np.diag(covariance), np.mean(rows**2, axis=0))
    assert np.linalg.eigvalsh(covariance).min() > 0
    np.testing.assert_array_equal(error_covariance(rows[:0]), np.zeros((20, 20)))


def test_the_prior_about_a_simulation_is_q_widened_in_proportion_to_the_event(network):
    simulation = network.decode(np.full((26, 1), 0.3))[0]
    mean, variance = network.encode(simulation)
    relative = np.asarray(read_card(SMALL_MODEL)["prior"]["relative_mismatch_covariance"])
    size = np.sqrt((simulation**2).sum(axis=1).mean())
    found = prior_of(network, simulation)
    np.testing.assert_array_equal(found.mean, mean)
    np.testing.assert_allclose(found.covariance, np.diag(variance) + size**2 * relative, rtol=1e-12)
    # A body at rest still has a wide prior; without a simulation it is that of all codes.
    rest = prior_of(network, np.zeros_like(simulation))
    assert np.trace(rest.covariance) >= 0.09 * np.trace(relative)
    np.testing.assert_array_equal(prior_of(network, None).covariance, network.prior().covariance)


def test_errors_are_those_of_whole_fields_or_of_changes(network):
    np.testing.assert_array_equal(errors_of(network, simulated=False), network.errors())
    with np.load(SMALL_MODEL / "decoder_weights.npz") as weights:
        np.testing.assert_array_equal(errors_of(network, simulated=True), weights["change_error_fields_mm"])
    model = PcaModel(np.zeros((5, 3)), np.ones((1, 5, 3)), np.full((2, 5, 3), 0.1), {})
    np.testing.assert_array_equal(errors_of(model, simulated=True), model.error_fields)
    np.testing.assert_array_equal(prior_of(model, np.ones((5, 3))).covariance, np.eye(1))


def test_a_prior_is_widened_until_its_innovation_is_as_large_as_expected():
    rng = np.random.default_rng(3)
    slope = rng.standard_normal((9, 4))
    prior, family = Gaussian(rng.standard_normal(4), 0.01 * np.eye(4)), Gaussian(np.zeros(4), 100.0 * np.eye(4))
    draws = prior.mean[:, None] + 0.1 * rng.standard_normal((4, 30))
    centre, noise = slope @ prior.mean, 0.04 * np.eye(9)
    linear = LinearPredictions.of(prior, draws, slope @ draws, centre)
    np.testing.assert_allclose(linear.slope, slope, atol=1e-9)
    assert widened(prior, family, linear, centre + 0.1, noise) == (prior, 1.0)
    observed = centre + slope @ np.array([1.0, -1.0, 0.5, 1.0])
    wide, factor = widened(prior, family, linear, observed, noise)
    assert 10.0 < factor < 400.0
    innovation = observed - centre
    total = slope @ wide.covariance @ slope.T + noise
    assert innovation @ np.linalg.solve(total, innovation) == pytest.approx(9.0, rel=1e-6)
    # About the factor times the prior, since the family is far wider.
    np.testing.assert_allclose(wide.covariance, factor * prior.covariance, rtol=0.05, atol=1e-6)
    assert LinearPredictions.of(prior, draws[:, :4], slope @ draws[:, :4], centre) is None
