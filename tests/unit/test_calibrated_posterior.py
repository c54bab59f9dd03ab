"""The answer of a calibrated model: what whole fields, points and trust owe to the calibration."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.latent.calibrate import _mixing
from tissuereg.latent.calibration import Calibration, FieldErrors, Rehearsal
from tissuereg.latent.kinds import Kinds, probabilities
from tissuereg.latent.pca import PcaModel
from tissuereg.trust import judge_by_rehearsal


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
    kinds = Kinds(np.array([0.6, 0.4]), np.zeros((2, 4)), np.array([0.5 * np.eye(4), 3.0 * np.eye(4)]))
    return Calibration(kinds, errors, Rehearsal(np.array([0.6, 1.8]), np.array([0.5, 0.5])))


def registered(mesh, calibration):
    """Return a registration of a field by a linear model that cannot represent all of it, and the target's node."""
    model = PcaModel(
        np.zeros((mesh.n_nodes, 3)), smooth_fields(mesh, 4, 2), np.empty((0, mesh.n_nodes, 3)), np.empty(0), {}
    )
    model.calibration = calibration
    truth = smooth_fields(mesh, 9, 3).sum(axis=0)
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)[::5][:8]
    target = int(np.setdiff1d(np.arange(mesh.n_nodes), np.unique(mesh.surface))[0])
    reference = mesh.nodes[free]
    markers = tr.Markers(reference, reference + truth[free], 0.05)
    targets = {"t": mesh.nodes[target]}
    return tr.register(mesh, markers, model=model, targets=targets, threads=1), target


def test_the_whole_field_is_that_of_the_points(mesh, calibration):
    result, target = registered(mesh, calibration)
    at_target = result.target("t").mean - mesh.nodes[target]
    residual = np.array(list(result.markers.residual_mm.values()))
    assert np.abs(residual).max() > 0
    # A linear decoder and errors in patterns alone: the two are the same sum, up to rounding of the derivatives.
    np.testing.assert_allclose(result.displacement[target], at_target, atol=1e-9 * mesh.extent)


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


@pytest.mark.parametrize(("distance", "far"), [(990.0, False), (999.0, True)])
def test_a_shape_is_unfamiliar_beyond_a_third_of_a_percent_of_the_honest_ones(distance, far):
    honest = Rehearsal(np.ones(1), np.ones(1), distances=np.arange(1.0, 1001.0))
    residual, noise = np.zeros((2, 3)), np.eye(6)
    trust = judge_by_rehearsal(("a", "b"), residual, noise, 0.2 * noise, honest, 0.5, distance, 0.9, [])
    assert any(reason.startswith("unfamiliar") for reason in trust.reasons) is far
