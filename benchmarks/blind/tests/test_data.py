"""What is stored: whole, sealed, readable by the package, and of the size that was promised."""

import hashlib
import json

import numpy as np
import pytest

import tissuereg as tr
from blind.generator.open_cases import make_open_cases
from blind.materialise import CASES, DATA, case_names, materialise
from blind.run import tier_cases
from blind.scored import open_answers
from tissuereg.simulation.experiment import simulate_plain

LINES = [line.split("  ") for line in (DATA / "SHA256SUMS").read_text(encoding="utf-8").splitlines()]


def test_every_stored_file_has_its_checksum():
    wrong = [name for digest, name in LINES if hashlib.sha256((DATA / name).read_bytes()).hexdigest() != digest]
    assert wrong == []
    assert {path.name for path in CASES.glob("*.npz")} == {name.split("/")[1] for _, name in LINES if "cases/" in name}


def test_the_store_stays_below_60_megabytes():
    assert sum((DATA / name).stat().st_size for _, name in LINES) < 60e6


def test_every_answer_is_the_sealed_one():
    assert set(open_answers(set(case_names()))) == set(case_names())


def test_an_answer_that_was_changed_is_refused(monkeypatch, tmp_path):
    for name in ("seals.csv", "answers.json.gz"):
        (tmp_path / name).write_bytes((DATA / name).read_bytes())
    first = case_names()[0]
    rows = (tmp_path / "seals.csv").read_text(encoding="utf-8").splitlines()
    rows = [f"{first},{'0' * 64}" if row.startswith(first) else row for row in rows]
    (tmp_path / "seals.csv").write_text("\n".join(rows), encoding="utf-8")
    monkeypatch.setattr("blind.scored.DATA", tmp_path)
    with pytest.raises(ValueError, match=f"the answer of {first} must be the sealed one"):
        open_answers({first})


@pytest.mark.parametrize("case", [*tier_cases("quick")[:6], *tier_cases("fine")[:1]])
def test_a_case_is_an_experiment_of_the_format(case, tmp_path):
    experiment = tr.read_experiment(materialise(case, tmp_path / case))
    fine = case in json.loads((DATA / "tiers.json").read_text(encoding="utf-8"))["fine"]
    assert (3000 if fine else 400) < len(experiment.mesh.nodes) < (5000 if fine else 800)
    assert next(iter(experiment.cases)) == experiment.rest_case == "rest"
    assert len(experiment.marker_names) == 25
    assert all(len(actuator.nodes) >= 3 for actuator in experiment.actuators)
    assert 0.02 <= experiment.marker_std <= 0.2


def test_the_rest_frames_of_a_case_scatter_as_it_says(tmp_path):
    case = tier_cases("quick")[0]
    experiment = tr.read_experiment(materialise(case, tmp_path))
    with np.load(CASES / f"{case}.npz") as stored:
        rest = stored["markers"][:6] * 1e-4
    spread = np.sqrt(((rest - rest.mean(axis=0)) ** 2).sum() / (5 * 75))
    assert spread == pytest.approx(experiment.marker_std, rel=0.5)


def test_a_believed_model_moves_the_markers_as_the_foreign_one_does(tmp_path):
    # Whatever is hidden, most of the motion is that of the push; noise and the user's coarse mesh leave 0.94 under the
    # smallest stroke, places that are mixed up 0.3.
    case = tier_cases("fine")[0]
    experiment = tr.read_experiment(materialise(case, tmp_path))
    simulated = simulate_plain(experiment, threads=1)
    for name in ("push_x", "push_y", "push_z"):
        hold = slice(2, 9)
        seen = np.nanmean(experiment.cases[name].markers[hold], axis=0) - experiment.marker_reference
        predicted = simulated[name].markers[hold].mean(axis=0) - experiment.marker_reference
        assert np.corrcoef(seen.ravel(), predicted.ravel())[0, 1] > 0.9


def test_open_cases_have_the_wanted_size_and_come_with_their_truth(tmp_path):
    truth = make_open_cases(13.0, tmp_path, rigs=(1,))
    assert len(truth) > 5
    for name, hidden in truth.items():
        assert hidden["detectability"] == pytest.approx(13.0, rel=0.02)
        experiment = tr.read_experiment(tmp_path / name)
        assert not experiment.effects
        assert set(experiment.cases) >= {"rest", "push_x"}
    assert json.loads((tmp_path / "truth.json").read_text(encoding="utf-8")).keys() == truth.keys()
