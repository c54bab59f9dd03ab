"""The shipped models register shapes that they never saw: a few draws of what the published table states."""

import numpy as np
import pytest

from common import REPOSITORY
from learned.__main__ import answer
from learned.cases import drawn
from learned.spoilt import CHANGES
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.settings import SmootherSettings
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.recipe import read_recipe, recipe_of

#: Shapes of the kind that the models were trained on, of a seed that their data do not have.
N_SHAPES, SEED = 16, 4711


@pytest.fixture(scope="module")
def cases():
    """A few shapes without a simulation."""
    raw = read_recipe(REPOSITORY / "training" / "recipes" / "breast.toml").raw
    few = recipe_of({**raw, "data": {**raw["data"], "members": N_SHAPES, "chunk": N_SHAPES}}, "recipe")
    mesh = phantom_mesh()
    fields = ChunkMaker(few, mesh, SEED).make(0).displacement
    return [drawn(mesh, field, None, [43, number], number) for number, field in enumerate(fields)]


@pytest.fixture(scope="module", params=["phantom", "phantom-graph"])
def model(request):
    return NetworkModel(shipped_model_folder(request.param), phantom_mesh(), threads=1)


def test_answers_are_right_and_regions_hold_their_share(cases, model):
    rows = [answer(model, one, None, SmootherSettings()) for one in cases]
    mean = {name: np.mean([row[name] for row in rows]) for name in ("before_mm", "after_mm", "held50", "held90")}
    assert mean["after_mm"] < 0.1 * mean["before_mm"]
    assert all(row["after_mm"] < row["before_mm"] for row in rows)
    assert 0.8 <= mean["held90"] <= 0.98
    assert 0.35 <= mean["held50"] <= 0.75
    assert sum(not row["trusted"] for row in rows) <= 1


def test_one_wrong_marker_is_named_and_its_answer_is_as_without_it(cases, model):
    change, rng = CHANGES["one marker off by 20 mm"], np.random.default_rng(0)
    spoilt = [change(one, cases, rng) for one in cases]
    rows = [answer(model, one, wrong, SmootherSettings()) for one, wrong in spoilt]
    assert sum(row["named"] for row in rows) >= 14
    assert not any(row["silent"] for row in rows)
    assert np.median([row["after_mm"] for row in rows]) < 0.3


@pytest.mark.parametrize("name", ["random markers", "noise ten times as stated", "two markers swapped"])
def test_garbage_is_distrusted(cases, model, name):
    rng = np.random.default_rng(1)
    rows = [answer(model, CHANGES[name](one, cases, rng)[0], None, SmootherSettings()) for one in cases[:8]]
    assert not any(row["silent"] for row in rows)
    assert sum(row["trusted"] for row in rows) <= 1
