"""The embedded phantom: its two sizes, its event, and the truth that comes with it."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import tissuereg as tr
from support.scripts import REPOSITORY
from tissuereg.errors import ArgumentError
from tissuereg.phantom import SIZES, phantom_mesh, true_fields, truth_mesh
from tissuereg.phantom.event import LESION_MM, make_event, shipped_recipe, solve_truth

#: As many nodes as the paper's breast phantom has.
PAPER_NODES = 4223


def test_the_full_body_is_the_one_that_the_formula_gives():
    assert phantom_mesh("full").digest() == tr.phantom.breast_mesh(PAPER_NODES).digest()


def test_the_recipe_in_the_package_is_the_one_in_training_and_names_the_full_body():
    recipe = shipped_recipe()
    assert recipe.path.read_bytes() == (REPOSITORY / "training" / "recipes" / "breast.toml").read_bytes()
    assert recipe.mesh().digest() == phantom_mesh("full").digest()


@pytest.mark.parametrize("size", SIZES)
def test_the_truth_has_a_finer_mesh_that_shares_no_inner_node(size):
    body, truth = phantom_mesh(size), truth_mesh(size)
    assert truth.n_nodes > body.n_nodes
    inner = [mesh.nodes[np.setdiff1d(np.arange(mesh.n_nodes), mesh.surface_nodes)] for mesh in (body, truth)]
    gaps, _ = cKDTree(inner[1]).query(inner[0])
    assert gaps.min() > 0.01


@pytest.mark.parametrize("size", ["small", pytest.param("full", marks=pytest.mark.slow)])
def test_the_truth_that_is_kept_is_that_of_the_solver(size):
    for kept, solved in zip(true_fields(size), solve_truth(size), strict=True):
        assert np.abs(solved).max() > 5.0
        # A residual of 1e-7 of the load, and single precision in the file.
        np.testing.assert_allclose(kept, solved, rtol=0, atol=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_the_simulation_of_the_event_is_off_its_truth_by_a_part_of_the_motion(size):
    event = make_event(seed=0, size=size)
    simulation = tr.simulate(event.mesh, event.load, event.material).displacement
    motion, off = (
        np.linalg.norm(u, axis=1).mean() for u in (event.true_displacement, simulation - event.true_displacement)
    )
    assert 2.0 < motion < 6.0
    assert 0.1 < off / motion < 0.3
    assert np.linalg.norm(event.true_lesion - LESION_MM) > 3.0


def test_a_seed_changes_markers_and_noise_and_not_the_truth():
    one, other = (make_event(seed=seed, size="small") for seed in (0, 1))
    assert np.array_equal(one.true_displacement, other.true_displacement)
    assert np.abs(one.markers.reference - other.markers.reference).max() > 1.0
    noise = one.markers.displacement - one.true_markers
    assert 0.05 < noise.std() < 0.2


def test_another_size_is_refused():
    with pytest.raises(ArgumentError, match="`size` must be one of full, small, got 'large'"):
        phantom_mesh("large")
