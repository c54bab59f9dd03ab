"""Methods in a latent space on a linear decoder with a Gaussian prior, where the Kalman equations are exact."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.learned.pca import PcaModel
from tissuereg_paper.rivals import LatentFilter, OneStepSmoother, PcaEsMda, Setting

#: On the surface, so that what they see is linear.
PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0], [15.0, 20.0, 35.0], [30.0, 5.0, 20.0]])
STD_MM, FRAME_S, MEMORY_S, N_LATENT = 0.3, 0.025, 0.1, 4


def smooth_fields(mesh, count, seed):
    """Return random combinations of smooth fields that vanish at the base, of a tenth of a millimetre or so."""
    rng = np.random.default_rng(seed)
    x, y, z = np.array(mesh.nodes).T / 40.0
    shapes = np.stack([z, z * z, z * x, z * y, np.sin(2.0 * z) * x])
    return np.einsum("fks,sn->fnk", 0.2 * rng.standard_normal((count, 3, len(shapes))), shapes)


@pytest.fixture(scope="module")
def model(block_mesh):
    fields = smooth_fields(block_mesh, 40, 0)
    return PcaModel.fit(fields, fields[:0], centre=fields.mean(axis=0), n_latent=N_LATENT, card={})


def setting(mesh, **parts) -> Setting:
    given = {"reference_mm": PLACES, "std_mm": np.full(5, STD_MM), "material": tr.Material(), "frame_s": FRAME_S}
    return Setting(mesh, **{**given, "threads": 1, **parts})


def at_markers(mesh, fields):
    observed = MarkerObservation(mesh, PLACES, tuple("abcde"))
    return observed.predict(fields[..., observed.nodes, :])


def kalman(mean, covariance, slope, observed):
    """Return the posterior of latents by the Kalman equations."""
    gain = covariance @ slope.T @ np.linalg.inv(slope @ covariance @ slope.T + STD_MM**2 * np.eye(len(slope)))
    return mean + gain @ observed, covariance - gain @ slope @ covariance


def slope_of(mesh, model, seen):
    return at_markers(mesh, model.components)[:, seen].reshape(N_LATENT, -1).T


@pytest.mark.parametrize("rival", [OneStepSmoother, LatentFilter])
def test_the_first_moment_is_the_kalman_answer_of_a_linear_decoder(block_mesh, model, rival):
    rng = np.random.default_rng(1)
    truth = model.decode(rng.standard_normal((N_LATENT, 1)))[0]
    measured = PLACES + at_markers(block_mesh, truth) + STD_MM * rng.standard_normal(PLACES.shape)
    measured[3] = np.nan
    seen = [0, 1, 2, 4]
    lacks = (measured - PLACES - at_markers(block_mesh, model.centre))[seen].ravel()
    mean, covariance = kalman(np.zeros(N_LATENT), np.eye(N_LATENT), slope_of(block_mesh, model, seen), lacks)
    found = rival(setting(block_mesh, model=model), spread=True).register(measured)
    assert found.kept["widened"] == 1.0
    # Balanced draws have exact moments: only rounding is left.
    np.testing.assert_allclose(found.displacement_mm, model.decode(mean[:, None])[0], atol=1e-11)
    np.testing.assert_allclose(np.cov(found.kept["latents"]), covariance, atol=1e-11)
    variance = np.einsum("lnx,lk,knx->n", model.components, covariance, model.components)
    np.testing.assert_allclose((found.spread_mm**2).sum(axis=1), variance, atol=1e-11)


def test_the_filter_is_the_kalman_filter_of_an_autoregressive_error(block_mesh, model):
    rng = np.random.default_rng(2)
    rival = LatentFilter(setting(block_mesh, model=model), memory_s=MEMORY_S)
    slope = slope_of(block_mesh, model, slice(None))
    share = np.exp(-FRAME_S / MEMORY_S)
    mean, covariance = np.zeros(N_LATENT), np.eye(N_LATENT)
    error = rng.standard_normal(N_LATENT)
    for _ in range(4):
        truth = model.decode(error[:, None])[0]
        measured = PLACES + at_markers(block_mesh, truth) + STD_MM * rng.standard_normal(PLACES.shape)
        lacks = (measured - PLACES - at_markers(block_mesh, model.centre)).ravel()
        mean, covariance = kalman(mean, covariance, slope, lacks - slope @ mean)
        found = rival.register(measured)
        np.testing.assert_allclose(found.displacement_mm, model.decode(mean[:, None])[0], atol=1e-10)
        np.testing.assert_allclose(np.cov(found.kept["latents"]), covariance, atol=1e-10)
        mean, covariance = share * mean, share**2 * covariance + (1.0 - share**2) * np.eye(N_LATENT)
        error = share * error + np.sqrt(1.0 - share**2) * rng.standard_normal(N_LATENT)


def test_a_filter_that_forgets_at_once_is_the_smoother(block_mesh, model):
    rng = np.random.default_rng(3)
    filtered = LatentFilter(setting(block_mesh, model=model), memory_s=1e-4)
    for _ in range(2):
        measured = PLACES + 0.2 * rng.standard_normal(PLACES.shape)
        alone = OneStepSmoother(setting(block_mesh, model=model)).register(measured).displacement_mm
        # exp(-250) of the moment before is left.
        np.testing.assert_allclose(filtered.register(measured).displacement_mm, alone, atol=1e-11)


def test_a_filter_remembers_and_a_new_one_does_not(block_mesh, model):
    measured = PLACES + 0.2
    rival = LatentFilter(setting(block_mesh, model=model))
    first = rival.register(measured).displacement_mm
    assert not np.array_equal(rival.register(measured).displacement_mm, first)
    again = LatentFilter(setting(block_mesh, model=model))
    np.testing.assert_array_equal(again.register(measured).displacement_mm, first)


@pytest.mark.parametrize("simulated", [False, True])
def test_es_mda_in_principal_components_is_the_closed_form(block_mesh, simulated):
    fields = smooth_fields(block_mesh, 60, 4)
    rival = PcaEsMda(setting(block_mesh, fields=fields), n_latent=N_LATENT)
    truth, simulation = smooth_fields(block_mesh, 2, 5)
    if not simulated:
        simulation, scale = fields[np.arange(60) % 10 > 0].mean(axis=0), 1.0  # the mean of those that are not held out
    measured = PLACES + at_markers(block_mesh, truth)
    found = rival.register(measured, simulation if simulated else None)
    lacks, seen = measured - PLACES - at_markers(block_mesh, simulation), np.arange(5)
    expected = rival.prior.answer(lacks, seen, None if simulated else scale)
    np.testing.assert_allclose(found.displacement_mm, simulation + expected.displacement_mm, atol=1e-10)
    assert found.kept["scale"] == pytest.approx(expected.scale, rel=1e-12)


def test_a_field_of_the_family_is_found_in_the_spread_that_is_stated(block_mesh):
    rival = PcaEsMda(setting(block_mesh, fields=smooth_fields(block_mesh, 200, 6)), n_latent=N_LATENT)
    rng = np.random.default_rng(7)
    free, squares = np.setdiff1d(np.arange(block_mesh.n_nodes), block_mesh.fixed_nodes), []
    for truth in smooth_fields(block_mesh, 60, 8):
        found = rival.register(PLACES + at_markers(block_mesh, truth) + STD_MM * rng.standard_normal(PLACES.shape))
        squares.append(np.mean((found.displacement_mm - truth)[free] ** 2 / found.spread_mm[free] ** 2))
    # Four latents of sixty fields: 240 independent squares give one with a deviation of 0.09; three of these.
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


def test_fewer_than_twenty_training_fields_are_refused(block_mesh):
    with pytest.raises(tr.errors.ArgumentError, match="at least 20 training fields, got 19"):
        PcaEsMda(setting(block_mesh, fields=smooth_fields(block_mesh, 19, 9)))
