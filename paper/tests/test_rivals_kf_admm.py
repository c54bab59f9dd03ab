"""KF-ADMM: the filter against full matrices, the modes against the solver, and the method on a stiffer truth."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import ArgumentError, LoadError
from tissuereg.simulation.solve import Simulator
from tissuereg_paper import _core
from tissuereg_paper.rivals import KfAdmm, Setting
from tissuereg_paper.rivals.modal_filter import ModalFilter
from tissuereg_paper.rivals.modes import admm_modes, vibration_modes

DT = 0.025


def masses_of(mesh: tr.Mesh) -> np.ndarray:
    """Return lumped masses of a body of 1 g/cm^3, kg."""
    return np.bincount(mesh.tets.ravel(), np.repeat(0.25e-6 * mesh.volumes, 4), mesh.n_nodes)


def rest_stiffness(mesh: tr.Mesh, material: tr.Material, free: np.ndarray) -> np.ndarray:
    """Return the stiffness at rest on free components, mN/mm, as the inverse of responses to unit forces."""
    simulator = Simulator(mesh)
    rest = simulator.body.linearise(np.zeros_like(mesh.nodes), *simulator.moduli(material))
    forces = np.eye(3 * mesh.n_nodes).reshape(-1, mesh.n_nodes, 3)[free]
    return np.linalg.inv(rest.responses(np.ascontiguousarray(forces)).reshape(len(forces), -1)[:, free])


@pytest.fixture
def small() -> tr.Mesh:
    """Return a block of 3 x 2 x 2 cells, clamped below."""
    return block((30.0, 20.0, 20.0), (3, 2, 2))


def free_components(mesh: tr.Mesh) -> np.ndarray:
    free = np.ones((mesh.n_nodes, 3), dtype=bool)
    free[mesh.fixed_nodes] = False
    return np.flatnonzero(free.ravel())


def test_the_filter_in_all_modes_is_the_filter_of_full_matrices(small):
    material, free, rng = tr.Material(10.0, 0.45), free_components(small), np.random.default_rng(3)
    masses = masses_of(small)
    mass, stiffness = np.repeat(masses, 3)[free], rest_stiffness(small, material, free)
    n, force_std = len(free), 0.7
    step = np.linalg.solve(np.diag(mass) + DT**2 * stiffness, np.diag(mass))
    transition = np.block([[step, DT * step], [(step - np.eye(n)) / DT, step]])
    reach = np.vstack([DT**2 * step, DT * step]) @ np.diag(1.0 / mass)
    noise = force_std**2 * reach @ np.diag(mass) @ reach.T
    observed = rng.standard_normal((6, n)) * (rng.random((6, n)) < 0.1)
    variance = np.full(6, 0.04)
    modes = vibration_modes(small, material, masses, n)
    shapes = modes.shapes.reshape(len(modes.shapes), -1)[:, free]
    own = ModalFilter(modes.squares, DT, force_std)
    full = np.zeros((2 * n, 2 * n))
    for _ in range(4):
        innovation = rng.standard_normal(6)
        own.predict()
        amplitudes, rates = own.update(observed @ shapes.T, variance, innovation)
        full = transition @ full @ transition.T + noise
        sight = np.hstack([observed, np.zeros((6, n))])
        gain = full @ sight.T @ np.linalg.inv(sight @ full @ sight.T + np.diag(variance))
        full = full - gain @ sight @ full
        change = gain @ innovation
        both = np.concatenate([amplitudes @ shapes, rates @ shapes])
        # The inverse of the stiffness loses some six digits.
        np.testing.assert_allclose(both, change, atol=1e-8 * np.abs(change).max())
        basis = np.kron(np.eye(2), shapes)
        np.testing.assert_allclose(basis.T @ own.covariance @ basis, full, atol=1e-8 * np.abs(full).max())


def test_modes_are_orthonormal_and_solve_their_equation(small):
    material, masses = tr.Material(10.0, 0.45), masses_of(small)
    modes = vibration_modes(small, material, masses, 12)
    weighted = modes.shapes * masses[None, :, None]
    gram = np.einsum("jnx,knx->jk", weighted, modes.shapes)
    np.testing.assert_allclose(gram, np.eye(12), atol=1e-10)
    simulator = Simulator(small)
    rest = simulator.body.linearise(np.zeros_like(small.nodes), *simulator.moduli(material))
    moved = rest.responses(np.ascontiguousarray(weighted * modes.squares[:, None, None]))
    # Eigenvectors of Lanczos' method are good to the root of rounding or better.
    np.testing.assert_allclose(moved, modes.shapes, atol=1e-7 * np.abs(modes.shapes).max())
    assert (np.diff(modes.squares) >= 0.0).all()
    assert (modes.shapes[:, small.fixed_nodes] == 0.0).all()


@pytest.mark.parametrize("modes", [vibration_modes, admm_modes])
def test_few_modes_of_lanczos_are_the_first_of_all_modes(small, modes):
    material, masses = tr.Material(10.0, 0.45), masses_of(small)
    few, every = modes(small, material, masses, 8), modes(small, material, masses, 10_000)
    assert len(every.squares) == len(free_components(small))
    np.testing.assert_allclose(few.squares, every.squares[:8], rtol=1e-9)


def test_modes_of_admm_are_those_of_its_global_step(small):
    material, masses, dt = tr.Material(10.0, 0.45), masses_of(small), 0.01
    modes = admm_modes(small, material, masses, 10_000)
    weighted = modes.shapes * masses[None, :, None]
    gram = np.einsum("jnx,knx->jk", weighted, modes.shapes)
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-10)
    # One iteration from rest: z stays the rest shape, so that a small force moves x by (M + dt^2 D'W^2D)^-1 dt^2 f.
    held = small.fixed_nodes
    body = _core.AdmmBody(small.nodes, small.tets, held, *Simulator(small).moduli(material), density=1.0)
    force = np.random.default_rng(5).standard_normal(small.nodes.shape)
    body.set_state(np.zeros_like(small.nodes), np.zeros_like(small.nodes))
    body.step(dt, 1, forces=1e-3 * force, prescribed=np.zeros((len(held), 3)))
    amplitudes = dt**2 / (1.0 + dt**2 * modes.squares) * np.einsum("jnx,nx->j", modes.shapes, 1e-3 * force)
    expected = np.einsum("j,jnx->nx", amplitudes, modes.shapes)
    # The local step leaves the rest shape by what the small force moves.
    np.testing.assert_allclose(body.displacement, expected, atol=1e-6 * np.abs(expected).max())


def pulled(mesh: tr.Mesh, young: float) -> np.ndarray:
    """Return the displacement of a block whose top is pulled aside by 300 mN, mm."""
    top = np.flatnonzero(mesh.nodes[:, 2] > mesh.nodes[:, 2].max() - 1e-9)
    forces = np.zeros_like(mesh.nodes)
    forces[top] = np.array([300.0, 0.0, -100.0]) / len(top)
    return tr.simulate(mesh, tr.Load(forces=forces), tr.Material(young, 0.45)).displacement


@pytest.fixture
def seen(small) -> tuple[Setting, np.ndarray]:
    """Return a setting with markers at a third of the free surface's nodes, and their nodes."""
    nodes = np.setdiff1d(small.surface_nodes, small.fixed_nodes)[::3]
    return Setting(small, small.nodes[nodes], np.full(len(nodes), 0.05), tr.Material(10.0, 0.45)), nodes


def test_markers_that_agree_with_the_simulation_leave_it_as_it_is(seen):
    setting, nodes = seen
    simulation = pulled(setting.mesh, 10.0)
    rival = KfAdmm(setting, n_iterations=200)
    for _ in range(5):
        found = rival.register(setting.reference_mm + simulation[nodes], simulation)
    # What two hundred iterations of ADMM leave, of some 4 mm.
    np.testing.assert_allclose(found.displacement_mm, simulation, atol=1e-4)


def test_a_softer_truth_is_followed_at_nodes_without_markers(seen):
    setting, nodes = seen
    simulation, truth = pulled(setting.mesh, 10.0), pulled(setting.mesh, 7.0)
    others = np.setdiff1d(np.arange(setting.mesh.n_nodes), np.union1d(nodes, setting.mesh.fixed_nodes))
    rival = KfAdmm(setting)
    for _ in range(8):
        found = rival.register(setting.reference_mm + truth[nodes], simulation)
    before = np.linalg.norm((simulation - truth)[others], axis=1).mean()
    after = np.linalg.norm((found.displacement_mm - truth)[others], axis=1).mean()
    assert after < 0.5 * before
    assert found.spread_mm is not None
    assert found.spread_mm[nodes].mean() < found.spread_mm[others].mean()


def test_a_marker_that_is_not_seen_is_left_out_and_moments_are_remembered(seen):
    setting, nodes = seen
    simulation, truth = pulled(setting.mesh, 10.0), pulled(setting.mesh, 7.0)
    measured = setting.reference_mm + truth[nodes]
    measured[1::2] = np.nan
    rival = KfAdmm(setting)
    first = rival.register(measured, simulation)
    second = rival.register(measured, simulation)
    assert np.abs(second.displacement_mm - first.displacement_mm).max() > 1e-6
    np.testing.assert_array_equal(KfAdmm(setting).register(measured, simulation).displacement_mm, first.displacement_mm)
    half = Setting(setting.mesh, setting.reference_mm[::2], setting.std_mm[::2], setting.material)
    alone = KfAdmm(half).register(measured[::2], simulation)
    np.testing.assert_allclose(alone.displacement_mm, first.displacement_mm, atol=1e-12)


@pytest.mark.parametrize(("carried", "stays"), [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)])
def test_of_what_was_corrected_at_driven_nodes_a_share_is_carried_on(seen, carried, stays):
    setting, nodes = seen
    driven = np.flatnonzero(setting.mesh.nodes[:, 2] > 20.0 - 1e-9)
    pressed = Setting(setting.mesh, setting.reference_mm, setting.std_mm, setting.material, driven=driven)
    simulation, truth = pulled(setting.mesh, 10.0), pulled(setting.mesh, 7.0)
    rival = KfAdmm(pressed, carried=carried)
    for _ in range(3):
        before = rival.register(setting.reference_mm + truth[nodes], simulation).displacement_mm
    assert np.abs((before - simulation)[driven]).mean() > 0.4  # of some 2 mm that the truth moves farther
    moved = 1.1 * simulation
    rival._predict(moved)
    expected = (moved + stays * (before - simulation))[driven]
    np.testing.assert_allclose(rival._body.displacement[driven], expected, atol=1e-12)


def test_a_moment_whose_simulation_is_inside_out_is_held_by_the_forces_before(seen):
    setting, nodes = seen
    simulation = pulled(setting.mesh, 10.0)
    measured = setting.reference_mm + simulation[nodes]
    spoilt = simulation.copy()
    spoilt[setting.mesh.tets[-1, 0]] += 40.0
    with pytest.raises(LoadError):
        KfAdmm(setting).register(measured, spoilt)
    rival, whole = KfAdmm(setting), KfAdmm(setting)
    for one in (rival, whole):
        one.register(measured, simulation)
    found, expected = rival.register(measured, spoilt), whole.register(measured, simulation)
    np.testing.assert_array_equal(found.displacement_mm, expected.displacement_mm)


@pytest.mark.parametrize(
    "given",
    [
        {"modes": "other"},
        {"n_modes": 0},
        {"noise_mm": 0.0},
        {"density_g_cm3": -1.0},
        {"n_iterations": 0.5},
        {"carried": 1.5},
    ],
)
def test_a_tuning_constant_out_of_its_range_is_refused(seen, given):
    with pytest.raises(ArgumentError, match=next(iter(given))):
        KfAdmm(seen[0], **given)
