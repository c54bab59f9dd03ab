"""Position-based dynamics: what it keeps, what it meets and what it leaves alone."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.mesh import det_f
from tissuereg.errors import ArgumentError
from tissuereg_paper.rivals import PositionBasedDynamics, Setting


@pytest.fixture
def small() -> tr.Mesh:
    """Return a block of 3 x 2 x 2 cells, clamped below."""
    return block((30.0, 20.0, 20.0), (3, 2, 2))


def pulled(mesh: tr.Mesh, young: float, poisson: float = 0.45) -> np.ndarray:
    """Return the displacement of a block whose top is pulled aside by 300 mN, mm."""
    top = np.flatnonzero(mesh.nodes[:, 2] > mesh.nodes[:, 2].max() - 1e-9)
    forces = np.zeros_like(mesh.nodes)
    forces[top] = np.array([300.0, 0.0, -100.0]) / len(top)
    return tr.simulate(mesh, tr.Load(forces=forces), tr.Material(young, poisson)).displacement


def setting_of(mesh: tr.Mesh, std_mm: float, poisson: float = 0.45) -> tuple[Setting, np.ndarray]:
    nodes = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::3]
    return Setting(mesh, mesh.nodes[nodes], np.full(len(nodes), std_mm), tr.Material(10.0, poisson)), nodes


def test_markers_that_agree_with_the_simulation_leave_it_as_it_is(small):
    setting, nodes = setting_of(small, 0.1)
    simulation = pulled(small, 10.0)
    rival = PositionBasedDynamics(setting)
    for _ in range(3):
        found = rival.register(setting.reference_mm + simulation[nodes], simulation)
    np.testing.assert_allclose(found.displacement_mm, simulation, atol=1e-10)  # rounding


def test_exact_markers_are_met_and_nodes_between_them_follow(small):
    setting, nodes = setting_of(small, 1e-4)
    simulation, truth = pulled(small, 10.0), pulled(small, 7.0)
    found = PositionBasedDynamics(setting, n_iterations=300).register(setting.reference_mm + truth[nodes], simulation)
    # Observations come last in every round.
    np.testing.assert_allclose(found.displacement_mm[nodes], truth[nodes], atol=1e-3)
    others = np.setdiff1d(np.arange(small.n_nodes), np.union1d(nodes, small.fixed_nodes))
    before = np.linalg.norm((simulation - truth)[others], axis=1).mean()
    assert np.linalg.norm((found.displacement_mm - truth)[others], axis=1).mean() < 0.6 * before
    np.testing.assert_array_equal(found.displacement_mm[small.fixed_nodes], 0.0)


def test_a_nearly_incompressible_body_keeps_the_volume_of_its_tets(small):
    setting, _ = setting_of(small, 1e-2, poisson=0.4999)
    simulation, still = np.zeros_like(small.nodes), PositionBasedDynamics(setting, n_iterations=500)
    measured = setting.reference_mm + np.array([2.0, 0.0, 0.0]) * setting.reference_mm[:, 2:] / 20.0
    found = still.register(measured, simulation)
    soft = PositionBasedDynamics(setting_of(small, 1e-2, poisson=0.0)[0], n_iterations=500)
    own, other = (
        np.abs(det_f(small, f.displacement_mm) - 1.0).mean() for f in (found, soft.register(measured, simulation))
    )
    assert own < 0.2 * other


def test_the_correction_is_carried_on(small):
    setting, nodes = setting_of(small, 0.1)
    simulation, truth = pulled(small, 10.0), pulled(small, 7.0)
    rival = PositionBasedDynamics(setting, n_iterations=20)
    first = rival.register(setting.reference_mm + truth[nodes], simulation)
    second = rival.register(setting.reference_mm + truth[nodes], simulation)
    assert np.abs(second.displacement_mm - first.displacement_mm).max() > 1e-6
    again = PositionBasedDynamics(setting, n_iterations=20).register(setting.reference_mm + truth[nodes], simulation)
    np.testing.assert_array_equal(again.displacement_mm, first.displacement_mm)


@pytest.mark.parametrize("given", [{"energy_uj": 0.0}, {"n_iterations": 0}, {"density_g_cm3": -1.0}])
def test_a_tuning_constant_out_of_its_range_is_refused(small, given):
    with pytest.raises(ArgumentError, match=next(iter(given))):
        PositionBasedDynamics(setting_of(small, 0.1)[0], **given)
