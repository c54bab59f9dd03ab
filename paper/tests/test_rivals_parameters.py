"""Inference of stiffness and load by the solver, on cases that it simulated itself."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError
from tissuereg_paper.rivals import ParameterInference, Setting

BELIEVED = tr.Material(young=8.0, poisson=0.4, density=1.0)
STIFFNESS, LOAD = 1.4, 0.8
STD_MM = 0.02
PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0], [15.0, 20.0, 35.0], [30.0, 5.0, 20.0]])


def load(mesh, factor=1.0, weight=True) -> tr.Load:
    """Return a push on the top, and the weight of the body along x, which shears it."""
    top = mesh.surface[(mesh.nodes[mesh.surface][:, :, 2] == 40.0).all(axis=1)]
    body_force = 3.0 * BELIEVED.weight((1.0, 0.0, 0.0)) if weight else None
    return tr.Load(traction=(top, factor * np.array([0.0, 0.3, -0.8])), body_force=body_force)


def solved(mesh, load, material):
    """Return an equilibrium with the elements that registration takes on so coarse a mesh."""
    return tr.simulate(mesh, load, material, element="tet4-averaged", threads=1).displacement


@pytest.fixture(scope="module")
def truth(block_mesh):
    return solved(block_mesh, load(block_mesh, LOAD), tr.Material(young=8.0 * STIFFNESS, poisson=0.4))


def setting(mesh, **parts) -> Setting:
    given = {"reference_mm": PLACES, "std_mm": np.full(5, STD_MM), "material": BELIEVED, "load": load(mesh)}
    return Setting(mesh, **{**given, "threads": 1, **parts})


def measured(mesh, field):
    observed = MarkerObservation(mesh, PLACES, tuple("abcde"))
    rng = np.random.default_rng(0)
    return PLACES + observed.predict(field[observed.nodes]) + STD_MM * rng.standard_normal(PLACES.shape)


@pytest.mark.parametrize("simulated", [False, True])
def test_stiffness_and_load_of_a_simulated_case_are_found(block_mesh, truth, simulated):
    simulation = solved(block_mesh, load(block_mesh), BELIEVED) if simulated else None
    rival = ParameterInference(setting(block_mesh), spread=True)
    found = rival.register(measured(block_mesh, truth), simulation)
    off = np.log([found.kept["stiffness"] / STIFFNESS, found.kept["load"] / LOAD])
    covariance = found.kept["log_covariance"]
    # A chi-square of two degrees of freedom is above 13.8 once in a thousand.
    assert off @ np.linalg.solve(covariance, off) < 13.8
    assert np.sqrt(np.diag(covariance)).max() < 0.05  # the markers know both; before they were 0.6 and 0.3
    error, spread = found.displacement_mm - truth, found.spread_mm
    assert np.linalg.norm(error, axis=1).max() < 4.0 * np.linalg.norm(spread, axis=1).max()
    assert np.linalg.norm(error, axis=1).mean() < STD_MM  # fifteen coordinates for two unknowns


def test_without_weight_only_the_quotient_of_load_and_stiffness_is_found(block_mesh):
    push = load(block_mesh, LOAD, weight=False)
    truth = solved(block_mesh, push, tr.Material(young=8.0 * STIFFNESS, poisson=0.4))
    rival = ParameterInference(setting(block_mesh, load=load(block_mesh, weight=False)))
    found = rival.register(measured(block_mesh, truth))
    covariance = found.kept["log_covariance"]
    quotient, product = np.array([-1.0, 1.0]), np.array([1.0, 1.0])
    off = np.log(found.kept["load"] / found.kept["stiffness"] / (LOAD / STIFFNESS))
    assert abs(off) < 4.0 * np.sqrt(quotient @ covariance @ quotient)
    assert np.sqrt(quotient @ covariance @ quotient) < 0.02
    assert np.sqrt(product @ covariance @ product) > 0.3  # the prior's: sqrt(0.6^2 + 0.3^2) less what the data bind


def test_how_far_an_actuator_drives_a_body_is_found(block_mesh):
    top = np.flatnonzero(block_mesh.nodes[:, 2] == 40.0)
    held = np.union1d(block_mesh.fixed_nodes, top)
    simulator = tr.Simulator(block_mesh, element="tet4-averaged", held_nodes=held)

    def driven(factor):
        moved = np.where(np.isin(held, top)[:, None], factor * np.array([3.0, 0.0, -6.0]), 0.0)
        return simulator.solve(tr.Load(prescribed=moved), BELIEVED, threads=1).displacement

    truth, simulation = driven(0.7), driven(1.0)
    rival = ParameterInference(setting(block_mesh, load=None, driven=top))
    found = rival.register(measured(block_mesh, truth), simulation)
    assert found.kept["load"] == pytest.approx(0.7, rel=0.01)  # noise of 0.02 at five markers that move by 4 mm
    assert np.linalg.norm(found.displacement_mm - truth, axis=1).max() < 5.0 * STD_MM


def test_the_same_markers_again_halve_the_variance_where_nothing_drifts(block_mesh, truth):
    rival = ParameterInference(setting(block_mesh), drift=0.0)
    places = measured(block_mesh, truth)
    first = rival.register(places)
    halved = rival.register(places).kept["log_covariance"]
    # The prior of the first moment is wide, and the second begins where the markers are linear in the logarithms: both
    # to far less than a tenth.
    np.testing.assert_allclose(np.diag(halved), 0.5 * np.diag(first.kept["log_covariance"]), rtol=0.1)
    again = ParameterInference(setting(block_mesh), drift=0.0).register(places)
    np.testing.assert_array_equal(again.displacement_mm, first.displacement_mm)


def test_neither_simulation_nor_load_is_refused(block_mesh):
    with pytest.raises(ArgumentError, match="must have a simulation or a load"):
        ParameterInference(setting(block_mesh, load=None)).register(PLACES)
