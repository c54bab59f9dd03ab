"""The shipped models register shapes that they never saw: a few draws of what the published table states."""

import numpy as np
import pytest

from common import REPOSITORY, read_archive
from learned.__main__ import ARCHIVE
from learned.cases import drawn
from learned.run import answer
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
def name(request):
    return request.param


@pytest.fixture(scope="module")
def model(name):
    return NetworkModel(shipped_model_folder(name), phantom_mesh(), threads=1)


def test_answers_are_as_in_the_published_table(cases, name, model):
    rows = [answer(model, one, None, SmootherSettings()) for one in cases]
    assert all(row["after_mm"] < row["before_mm"] for row in rows)
    assert sum(not row["trusted"] for row in rows) <= 1
    method = {"phantom": "shipped", "phantom-graph": "graph"}[name]
    table = [row for row in read_archive(ARCHIVE)["rows"] if row["set"] == "known" and row["input"] == "honest"]
    for column in ("held50", "held90", "after_mm"):
        known = np.array([row[column] for row in table if row["method"] == method])
        # Other events of the same kind: three standard errors, of these few and of those of the table.
        error = known.std() * np.sqrt(1.0 / N_SHAPES + 1.0 / len(known))
        assert abs(np.mean([row[column] for row in rows]) - known.mean()) < 3.0 * error


def test_one_wrong_marker_is_named_and_its_answer_is_as_without_it(cases, model):
    change, rng = CHANGES["one marker off by 20 mm"], np.random.default_rng(0)
    spoilt = [change(one, cases, rng) for one in cases]
    rows = [answer(model, one, wrong, SmootherSettings()) for one, wrong in spoilt]
    assert sum(row["named"] for row in rows) >= 14
    assert not any(row["silent"] for row in rows)
    assert np.median([row["after_mm"] for row in rows]) < 0.3


@pytest.mark.parametrize("spoilt", ["random markers", "noise ten times as stated", "two markers swapped"])
def test_garbage_is_distrusted(cases, name, model, spoilt):
    rng = np.random.default_rng(1)
    rows = [answer(model, CHANGES[spoilt](one, cases, rng)[0], None, SmootherSettings()) for one in cases[:8]]
    assert not any(row["silent"] for row in rows)
    # The graph network's own errors look like noise: it notices half of noise that is ten times as large.
    noise_of_graph = name == "phantom-graph" and spoilt.startswith("noise")
    assert sum(row["trusted"] for row in rows) <= (6 if noise_of_graph else 1)
