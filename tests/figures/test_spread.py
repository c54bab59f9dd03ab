"""Regions of the shipped model hold their share of the targets of shapes that it never saw; a few draws."""

import numpy as np
import pytest

from common import REPOSITORY
from spread.spread import event, measures, registered
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.recipe import read_recipe, recipe_of

#: Shapes of the kind that the model was trained on, of a seed that its data do not have.
N_SHAPES, SEED = 16, 4711


@pytest.fixture(scope="module")
def found():
    """Figures of the published table, on a few shapes without a simulation."""
    raw = read_recipe(REPOSITORY / "training" / "recipes" / "breast.toml").raw
    few = recipe_of({**raw, "data": {**raw["data"], "members": N_SHAPES, "chunk": N_SHAPES}}, "recipe")
    mesh = phantom_mesh()
    fields = ChunkMaker(few, mesh, SEED).make(0).displacement
    model = NetworkModel(shipped_model_folder(), mesh, threads=1)
    events = [event(mesh, field, None, [43, number]) for number, field in enumerate(fields)]
    method = registered(mesh, model)
    return measures(events, [method(one) for one in events], np.random.default_rng(0))


def test_regions_hold_their_share(found):
    assert 0.8 <= found["coverage"]["0.90"][0] <= 0.98
    assert 0.35 <= found["coverage"]["0.50"][0] <= 0.75


def test_errors_are_a_small_part_of_the_motion(found):
    assert found["after_mm"]["mean"] < 0.1 * found["before_mm"]["mean"]
    assert found["crps_mm"] < 0.2
    assert found["worse"] == 0
