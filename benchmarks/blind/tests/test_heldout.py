"""Held-out errors by block: exact where a model predicts exactly, and nothing leaks from the block itself."""

import numpy as np
import pytest

from blind.heldout import by_block
from blind.materialise import case_names, materialise
from tissuereg.diagnosis.proof import LinearModel
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.io.experiments import read_experiment


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    return SignalLayout(read_experiment(materialise(case_names()[0], tmp_path_factory.mktemp("case"))))


def test_a_model_predicts_what_other_cases_show_and_not_what_one_alone_shows(layout):
    everywhere, once = np.full(layout.size, 100.0), 100.0 * layout.of_case("push_y")
    nothing = np.zeros((0, layout.size))
    table = by_block(LinearModel(3.0 * everywhere, nothing), LinearModel(3.0 * everywhere, everywhere[None]), layout)
    assert table["push_y"] == [
        int(layout.seen[layout.of_case("push_y")].sum()),
        pytest.approx(300.0),
        pytest.approx(0.0, abs=0.01),
    ]
    table = by_block(LinearModel(3.0 * once, nothing), LinearModel(3.0 * once, once[None]), layout)
    assert table["push_y"][2] == pytest.approx(300.0)
    assert table["push_y, every 4th frame from 1"][2] == pytest.approx(0.0, abs=0.01)
    assert table["push_x"][1:] == [0.0, 0.0]


def test_frames_of_a_case_are_all_of_it(layout):
    flat = np.ones(layout.size)
    table = by_block(
        LinearModel(flat, np.zeros((0, layout.size))), LinearModel(flat, np.zeros((0, layout.size))), layout
    )
    for part in layout.parts:
        frames = [row[0] for name, row in table.items() if name.startswith(f"{part.name}, ")]
        assert len(frames) == 4
        assert sum(frames) == table[part.name][0]
