"""The answer of a calibrated model: what whole fields, points and trust owe to the calibration."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.small_model import SMALL_MODEL
from tissuereg.errors import EnsembleError
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.calibrate import _mixing
from tissuereg.registration.learned.calibration import Calibration, Change, FieldErrors, Rehearsal
from tissuereg.registration.learned.calibration_set import CalibrationSet
from tissuereg.registration.learned.components import Components, probabilities
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.registration.learned.registration import _against


def smooth_fields(mesh, n_fields, seed):
    """Return smooth random fields, zero at the held nodes, of a few hundredths of the block's extent."""
    rng = np.random.default_rng(seed)
    x = mesh.nodes / mesh.extent
    waves = np.array([np.sin(x @ rng.normal(scale=3.0, size=3) + rng.uniform(0, 6.0)) for _ in range(n_fields)])
    held = (x[:, 2] - x[:, 2].min())[None, :, None]
    return 0.02 * mesh.extent * held * waves[:, :, None] * rng.standard_normal((n_fields, 1, 3))


@pytest.fixture(scope="module")
def mesh():
    return block(cells=(4, 4, 5))


@pytest.fixture(scope="module")
def calibration(mesh):
    # Two kinds, two scales, errors in a few patterns and nothing beside them.
    patterns = smooth_fields(mesh, 5, 1)
    covariances = np.array([0.3 * np.eye(5), 1.5 * np.diag(np.arange(1.0, 6.0))])
    errors = FieldErrors(patterns, covariances, np.zeros((mesh.n_nodes, 3)))
    kinds = Components(np.array([0.6, 0.4]), np.zeros((2, 4)), np.array([0.5 * np.eye(4), 3.0 * np.eye(4)]))
    return Calibration(kinds, errors, Rehearsal(np.array([0.6, 1.8]), np.array([[0.5, 0.5]])))


def registered(mesh, calibration):
    """Return a registration of a field by a linear model that cannot represent all of it, and the target's node."""
    model = PcaModel(np.zeros((mesh.n_nodes, 3)), smooth_fields(mesh, 4, 2), np.empty((0, mesh.n_nodes, 3)), {})
    model.calibration = calibration
    truth = smooth_fields(mesh, 9, 3).sum(axis=0)
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)[::5][:8]
    target = int(np.setdiff1d(np.arange(mesh.n_nodes), np.unique(mesh.surface))[0])
    reference = mesh.nodes[free]
    markers = tr.Markers(reference, reference + truth[free], 0.05)
    targets = {"t": mesh.nodes[target]}
    return tr.register(mesh, markers, model=model, targets=targets, settings=tr.RegisterSettings(threads=1)), target


def test_the_whole_field_is_that_of_the_points(mesh, calibration):
    result, target = registered(mesh, calibration)
    at_target = result.target("t").mean - mesh.nodes[target]
    residual = np.array(list(result.markers.residual_mm.values()))
    assert np.abs(residual).max() > 0
    # A linear decoder and errors in patterns alone: the two are the same sum, up to rounding of the derivatives.
    np.testing.assert_allclose(result.displacement[target], at_target, atol=1e-9 * mesh.extent)


def test_a_body_that_moves_more_than_simulated_is_found_by_the_factor(phantom):
    simulation, result, target = phantom
    # Exact markers of 1.5 times the simulation; codes and errors may change by 0.1 mm, the factor by 0.3.
    off = result.displacement - 1.5 * simulation
    assert np.linalg.norm(off, axis=1).mean() < 0.05 * np.linalg.norm(simulation, axis=1).mean()
    at_target = result.target("t").mean - result.target("t").reference
    # The same sum at nodes and at points, up to the decoder's curvature and single precision.
    assert np.linalg.norm(result.displacement[target] - at_target) < 0.02 * np.linalg.norm(at_target)


def test_what_is_not_known_of_the_factor_is_part_of_the_spread(phantom):
    _, result, target = phantom
    # Variances of three components from 64 draws: each is known to a sixth, their sum to a tenth or so.
    assert result.std[target] ** 2 == pytest.approx(np.trace(result.target("t").covariance), rel=0.45)


@pytest.fixture(scope="module")
def phantom():
    """A simulated push of the small phantom, the registration of a truth of 1.5 times that, and the target's node."""
    body = tr.phantom.phantom_mesh("small")
    model = NetworkModel(SMALL_MODEL, body, threads=1)
    simulation = model.decode(np.full((26, 1), 0.3))[0]
    size = np.sqrt((simulation**2).sum(axis=1).mean())
    patterns = 0.1 / size * np.ones((1, body.n_nodes, 3))
    errors = FieldErrors(patterns, np.ones((1, 1, 1)), np.zeros((body.n_nodes, 3)))
    change = Change(np.array([0.0, 0.1]), (0.1 / size) ** 2 * np.eye(26)[None], errors)
    law = Rehearsal(np.ones(1), np.full((2, 1), 0.5))
    model.calibration = Calibration(
        Components(np.ones(1), np.zeros((1, 26)), np.eye(26)[None]),
        replace(errors, covariances=np.ones((1, 1, 1))),
        Rehearsal(np.ones(1), np.ones((1, 1))),
        change,
        law,
    )
    free = np.setdiff1d(np.unique(body.surface), body.fixed_nodes)
    chosen = free[:: len(free) // 15][:15]
    target = int(np.setdiff1d(np.arange(body.n_nodes), np.unique(body.surface))[40])
    reference = body.nodes[chosen]
    markers = tr.Markers(reference, reference + 1.5 * simulation[chosen], 0.05)
    targets = {"t": body.nodes[target]}
    result = tr.register(
        body, markers, model=model, simulation=simulation, targets=targets, settings=tr.RegisterSettings(threads=1)
    )
    return simulation, result, target


def test_covariances_are_multiplied_by_what_the_rehearsals_gave(mesh, calibration):
    wide = replace(calibration, alone=replace(calibration.alone, widening=2.0))
    one, two = (registered(mesh, each)[0].target("t").covariance for each in (calibration, wide))
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-12)


def test_probabilities_of_scales_are_those_that_the_events_have_under_them():
    logs = np.random.default_rng(0).normal(scale=2.0, size=(300, 4))
    weights = _mixing(logs)
    counts = probabilities(logs + np.log(weights)).sum(axis=0) + 1.0
    # A fixed point: one event for each scale beside the 300.
    np.testing.assert_allclose(weights, counts / counts.sum(), atol=1e-4)


def test_regions_are_those_of_the_law_that_the_rehearsals_gave(mesh, calibration):
    heavy = replace(calibration, alone=replace(calibration.alone, tail=3.0))
    one, other = (registered(mesh, each)[0].target("t") for each in (calibration, heavy))
    np.testing.assert_array_equal(other.region(0.9).radii, one.region(0.9).radii)
    assert (other.region(0.5).radii < one.region(0.5).radii).all()
    assert (other.region(0.99).radii > one.region(0.99).radii).all()


def test_a_shape_that_no_honest_event_has_is_unfamiliar(mesh, calibration):
    signs = np.column_stack([np.random.default_rng(4).exponential(size=(300, 2)), np.zeros((300, 3))])
    for most, trusted in ((1e6, True), (1e-3, False)):
        signs[:, 2] = np.linspace(0.0, most, 300)
        known = replace(
            calibration, alone=replace(calibration.alone, calibration_set=CalibrationSet.none().beside(signs))
        )
        reasons = registered(mesh, known)[0].trust.reasons
        assert any(reason.startswith("unfamiliar") for reason in reasons) is not trusted


@pytest.mark.parametrize(("factor", "against"), [(1.0, False), (0.05, False), (-0.05, True), (-1.0, True)])
def test_markers_that_move_against_their_simulation_are_a_reason(factor, against):
    rng = np.random.default_rng(5)
    simulated, std = rng.standard_normal((15, 3)), np.full((15, 3), 0.01)
    moved = factor * simulated + std * rng.standard_normal((15, 3))
    assert bool(_against(moved, simulated, std)) is against
    # Noise alone decides nothing, nor does a simulation in which nothing moves.
    assert not _against(std * rng.standard_normal((15, 3)), 0.01 * simulated, std)
    assert not _against(moved, np.zeros((15, 3)), std)


def test_markers_of_another_body_are_a_reason(mesh, calibration):
    model = PcaModel(np.zeros((mesh.n_nodes, 3)), smooth_fields(mesh, 4, 2), np.empty((0, mesh.n_nodes, 3)), {})
    model.calibration = calibration
    rng = np.random.default_rng(6)
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)[::2][:24]
    for off, trusted in ((0.0, True), (0.07 * mesh.extent, False)):
        places = mesh.nodes[free] + off * rng.uniform(-1.0, 1.0, (24, 3))
        registrar = tr.Registrar(mesh, tr.Markers(places, std=0.05), model)
        reasons = registrar.register(places + 0.05 * rng.standard_normal((24, 3))).trust.reasons
        kinds = [reason.split(":")[0] for reason in reasons]
        assert ("places" in kinds) is not trusted, reasons


@pytest.mark.parametrize("far", [1e5, 1e10])
def test_markers_beyond_the_reach_of_the_model_are_refused_with_what_is_suspected(far):
    body = phantom_mesh()
    markers = body.nodes[body.surface_nodes[::150]]
    away = far * np.array([1.0, 0.5, -0.2])
    with pytest.raises(EnsembleError, match="rigid motion: the measured places if moved back by"):
        tr.register(body, tr.Markers(markers, markers + away), model="phantom-graph")
