"""The methods of linear elasticity against dense linear algebra, their limits, and deformations that they contain."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.registration.linear_prior import LinearPrior
from tissuereg.simulation.sensitivity import Linearised
from tissuereg.simulation.solve import Simulator
from tissuereg_paper.rivals import Libr, LinearElastic, Setting

MATERIAL = tr.Material(young=8.0, poisson=0.4)

#: On four faces; two are off the surface, one lies inside a triangle.
PLACES = np.array(
    [
        [30.0, 10.0, 40.0],
        [0.0, 10.0, 35.0],
        [15.0, 0.0, 30.0],
        [15.0, 22.0, 35.0],
        [31.5, 5.0, 20.0],
        [7.0, 6.0, 40.0],
        [22.5, 20.0, 16.0],
    ]
)


def setting(mesh, std=0.1, **parts) -> Setting:
    given = {"reference_mm": PLACES, "std_mm": np.full(len(PLACES), std), "material": MATERIAL, "threads": 1}
    return Setting(mesh, **{**given, **parts})


def responses(mesh, forces):
    """Return the linear responses to fields of forces; averaged elements, as registration takes on so coarse a mesh."""
    simulator = Simulator(mesh, element="tet4-averaged")
    return Linearised(simulator, tr.Load(), MATERIAL, np.zeros_like(mesh.nodes), threads=1).responses(forces)


def stiffness(mesh):
    """Return the stiffness of the free coordinates, dense, and which these are."""
    free = np.setdiff1d(np.arange(mesh.n_nodes), mesh.fixed_nodes)
    units = np.zeros((3 * len(free), mesh.n_nodes, 3))
    units[np.arange(3 * len(free)), np.repeat(free, 3), np.tile(np.arange(3), len(free))] = 1.0
    return np.linalg.inv(responses(mesh, units)[:, free].reshape(3 * len(free), -1)), free


def seen_by(rival, field):
    """Return the displacement of the markers, to first order."""
    return rival.body.seen(field[None]).reshape(-1, 3)


def traction(mesh, size):
    """Return nodal forces of a traction on a part of the top."""
    top = mesh.surface[(mesh.nodes[mesh.surface][:, :, 2] == 40.0).all(axis=1)]
    pad = top[mesh.nodes[top][:, :, 0].mean(axis=1) > 12.0]
    return Simulator(mesh).forces(tr.Load(traction=(pad, size * np.array([0.3, 0.1, -1.0]))))


@pytest.fixture(scope="module")
def points(block_mesh):
    return LinearElastic(setting(block_mesh), smooth=False, rigid=0.0)


def test_least_energy_is_the_minimum_of_misfit_and_strain_energy(block_mesh, points):
    rng = np.random.default_rng(0)
    moved = rng.standard_normal(PLACES.shape)
    found = points.register(PLACES + moved)
    matrix, free = stiffness(block_mesh)
    c = np.zeros((3 * len(PLACES), block_mesh.n_nodes, 3))
    for row, (nodes, weights) in enumerate(points.body.rows):
        np.add.at(c[row], nodes, weights)
    c = c[:, free].reshape(len(c), -1)
    normal = c.T @ c / 0.1**2 + matrix / found.kept["scale"]
    expected = np.linalg.solve(normal, c.T @ moved.ravel() / 0.1**2).reshape(-1, 3)
    # Both lose digits to the condition of the stiffness, 1e4.
    np.testing.assert_allclose(found.displacement_mm[free], expected, atol=1e-9 * np.abs(moved).max())
    assert np.abs(found.displacement_mm[block_mesh.fixed_nodes]).max() == 0.0


@pytest.mark.parametrize("rival", [LinearElastic, Libr])
def test_without_noise_the_markers_are_reproduced(block_mesh, rival):
    rng = np.random.default_rng(1)
    made = rival(setting(block_mesh, std=1e-7))
    moved = rng.standard_normal(PLACES.shape)
    found = made.register(PLACES + moved)
    # The misfit is of the size of noise over displacement, 1e-7, times the spread of the compliance, below 1e3.
    np.testing.assert_allclose(seen_by(made, found.displacement_mm), moved, atol=1e-4)


def test_a_small_deformation_by_forces_at_the_markers_is_found(block_mesh):
    made = LinearElastic(setting(block_mesh, std=1e-9), smooth=False, rigid=0.0)
    forces = np.zeros((1, block_mesh.n_nodes, 3))
    for (nodes, weights), size in zip(made.body.rows, np.random.default_rng(2).standard_normal(21), strict=True):
        np.add.at(forces[0], nodes, size * weights)
    truth = responses(block_mesh, forces)[0]
    found = made.register(PLACES + seen_by(made, truth))
    np.testing.assert_allclose(found.displacement_mm, truth, atol=1e-6 * np.abs(truth).max())  # noise over size


def test_a_deformation_by_loads_on_few_cells_is_found_by_libr(block_mesh):
    made = Libr(setting(block_mesh, std=1e-9), n_cells=4, rigid=0.0)
    field = made._prior.field(np.random.default_rng(3).standard_normal(21))
    found = made.register(PLACES + seen_by(made, field))
    # Twelve loads, 21 coordinates: only the noise over the size, times the spread of the compliance, is left.
    np.testing.assert_allclose(found.displacement_mm, field, atol=1e-5 * np.abs(field).max())


def test_libr_with_a_cell_a_node_is_the_least_energy(block_mesh, points):
    made = Libr(setting(block_mesh), n_cells=block_mesh.n_nodes, rigid=0.0)
    moved = np.random.default_rng(4).standard_normal(PLACES.shape)
    found, expected = made.register(PLACES + moved), points.register(PLACES + moved)
    # All forces on the surface are among the loads; the energies of all pairs lose four digits.
    np.testing.assert_allclose(found.displacement_mm, expected.displacement_mm, atol=1e-8)


@pytest.mark.parametrize("rival", [LinearElastic, Libr])
def test_a_small_push_by_the_fem_is_found_better_than_by_nothing_and_by_a_spline(block_mesh, rival):
    from tissuereg_paper.rivals import Spline

    load = tr.Load(forces=traction(block_mesh, 0.02))
    truth = tr.simulate(block_mesh, load, MATERIAL, element="tet4-averaged", threads=1).displacement
    made = rival(setting(block_mesh, std=1e-3), rigid=0.0)
    measured = PLACES + made.body.observed.predict(truth[made.body.observed.nodes])

    def error(one):
        return np.linalg.norm(one.register(measured).displacement_mm - truth, axis=1).mean()

    size = np.linalg.norm(truth, axis=1).mean()
    assert error(made) < 0.5 * error(Spline(setting(block_mesh, std=1e-3)))
    assert error(made) < 0.1 * size  # markers do not see all of it, but elasticity says most


@pytest.mark.parametrize("rival", [LinearElastic, Libr])
def test_a_marker_that_is_not_seen_has_no_say(block_mesh, rival):
    moved = np.random.default_rng(5).standard_normal(PLACES.shape)
    some = moved.copy()
    some[[1, 4]] = np.nan
    few = np.setdiff1d(np.arange(len(PLACES)), [1, 4])
    # How far rigid motions go is told by all markers, seen or not.
    alone = rival(setting(block_mesh, reference_mm=PLACES[few], std_mm=np.full(len(few), 0.1)), rigid=0.0)
    expected = alone.register((PLACES + moved)[few]).displacement_mm
    found = rival(setting(block_mesh), rigid=0.0).register(PLACES + some).displacement_mm
    np.testing.assert_allclose(found, expected, atol=1e-9)  # rounding of other sums


@pytest.mark.parametrize("rival", [LinearElastic, Libr])
def test_a_simulation_that_explains_the_markers_is_the_answer(block_mesh, rival):
    made = rival(setting(block_mesh))
    simulation = responses(block_mesh, traction(block_mesh, 0.5)[None])[0]
    measured = PLACES + made.body.observed.predict(simulation[made.body.observed.nodes])
    found = made.register(measured, simulation)
    np.testing.assert_allclose(found.displacement_mm, simulation, atol=1e-12)


def test_an_energy_weight_is_used_as_given(block_mesh, points):
    moved = np.random.default_rng(6).standard_normal(PLACES.shape)
    weight = Libr(setting(block_mesh)).register(PLACES + moved).kept["energy_weight"]
    again = Libr(setting(block_mesh), energy_weight=weight).register(PLACES + moved)
    stiff = Libr(setting(block_mesh), energy_weight=1e12, rigid=0.0).register(PLACES + moved)
    assert again.kept["energy_weight"] == pytest.approx(weight, rel=1e-12)
    assert np.abs(stiff.displacement_mm).max() < 1e-6  # that weight allows no strain


def test_the_scale_is_that_of_the_highest_evidence():
    rng = np.random.default_rng(7)
    root = rng.standard_normal((12, 12))
    prior = LinearPrior(root @ root.T, rng.standard_normal((5, 3, 12)), np.full(4, 0.3))
    moved, seen = 3.0 * rng.standard_normal((4, 3)), np.arange(4)
    scale, evidence, _ = prior.scaled(moved, seen)
    covariance = scale * root @ root.T + 0.09 * np.eye(12)
    whitened = 12 * np.log(0.3)  # the density is that of displacements over the noise
    _, log_det = np.linalg.slogdet(2.0 * np.pi * covariance)
    direct = -0.5 * (log_det + moved.ravel() @ np.linalg.solve(covariance, moved.ravel())) + whitened
    assert evidence == pytest.approx(direct, rel=1e-12)
    # A parabola through tries an eighth of a power of ten apart misses the maximum by far less than two percent.
    assert all(prior.scaled(moved, seen, scale * factor)[1] < evidence for factor in (0.9, 1.1))


def test_what_is_kept_of_earlier_moments_changes_no_scale():
    rng = np.random.default_rng(8)
    root = rng.standard_normal((12, 12))
    prior = LinearPrior(root @ root.T, rng.standard_normal((5, 3, 12)), np.full(4, 0.3))
    values, vectors = np.linalg.eigh(root @ root.T / 0.09)
    tried = 10.0 ** np.linspace(-4.0, 16.0, 161) / values.max()
    for size in (1e-2, 1.0, 30.0):
        moved = size * rng.standard_normal((4, 3))
        squares = (vectors.T @ moved.ravel() / 0.3) ** 2
        cost = [np.sum(np.log1p(s * values) + squares / (1.0 + s * values)) for s in tried]
        at = int(np.argmin(cost))
        if at > 0:
            before, here, after = cost[at - 1 : at + 2]
            shift = 0.5 * (before - after) / (before - 2.0 * here + after)
            expected = tried[at] * (tried[1] / tried[0]) ** shift
        else:
            expected = tried[0]
        # Rounding of sums of a hundred, over the bend of the cost, a tenth.
        assert prior.scaled(moved, np.arange(4))[0] == pytest.approx(expected, rel=1e-11)


def test_markers_that_were_seen_together_before_take_no_new_eigenvalues(block_mesh, monkeypatch):
    made, counted, eigh = LinearElastic(setting(block_mesh)), [], np.linalg.eigh
    monkeypatch.setattr(np.linalg, "eigh", lambda matrix: counted.append(len(matrix)) or eigh(matrix))
    rng, some = np.random.default_rng(9), PLACES.copy()
    some[2] = np.nan
    for measured in (PLACES, PLACES, some, PLACES, some):
        made.register(measured + rng.standard_normal(PLACES.shape))
    assert sorted(counted) == sorted([21, 18] * len(made.priors))


@pytest.mark.parametrize("rival", [LinearElastic, Libr])
def test_a_base_that_gives_is_found_with_rigid_motions_alone(block_mesh, rival):
    turn = np.array([0.01, -0.02, 0.015])
    truth = np.array([1.0, -0.5, 0.3]) + np.cross(turn, block_mesh.nodes)

    def error(rigid):
        made = rival(setting(block_mesh, std=0.01), rigid=rigid)
        found = made.register(PLACES + seen_by(made, truth))
        return np.linalg.norm(found.displacement_mm - truth, axis=1).max()

    # All markers lie a millimetre from where they were; what elasticity alone makes of that leaves the base behind.
    assert error(1e6) < 0.01
    assert error(0.0) > 0.5
