"""``tissuereg calibrate``: a few events of the phantom calibrate a copy of the model that ships."""

import contextlib
import json
import shutil

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.cli import main
from tissuereg.phantom import shipped_model_folder

RECIPE = """seed = 3
[mesh]
file = "phantom"
[data]
members = 40
chunk = 40
largest_mm = [2.0, 8.0]
[pairs]
members = 2
element = "tet4"
"""


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    (folder / "recipe.toml").write_text(RECIPE)
    assert main(["simulate", str(folder / "recipe.toml"), "--out", str(folder / "data"), "--quiet"]) == 0
    shutil.copytree(shipped_model_folder(), folder / "model")
    (folder / "pairs").mkdir()
    fields = tr.open_dataset(folder / "data").displacement[:12]
    np.savez(folder / "pairs" / "pairs_0.npz", simulation_mm=fields[:6], truth_mm=1.2 * fields[:6])
    np.savez(folder / "pairs" / "pairs_1.npz", simulation_mm=fields[6:], truth_mm=0.9 * fields[6:])
    return folder


def test_a_model_is_calibrated_and_registers_with_it(folders, capsys, monkeypatch):
    words = ["calibrate", str(folders / "model"), "--data", str(folders / "data"), "--pairs", str(folders / "pairs")]
    told = {}

    @contextlib.contextmanager
    def shown(what, *, quiet):
        yield lambda *counts: told.setdefault(what, []).append(counts)

    monkeypatch.setattr("tissuereg.cli.calibrate.progress_bar", shown)
    code = main([*words, "--json", "-"])
    assert [what[0] for what in told] == ["1", "2", "3"]
    for counts in told.values():
        assert counts[-1][0] == counts[-1][1]
        assert counts == sorted(set(counts))
    assert len(told["2 of 3, trial registrations"]) > 50
    found = json.loads(capsys.readouterr().out)
    assert code == 0, found
    assert (code, found["schema"], found["pairs"]) == (0, "tissuereg.calibrate/1", 14)
    beside = found["beside_contacts"]
    for one in (beside["alone"], beside["simulated"]):
        assert one["events"] > 0
        assert max(one["model"], one["contacts"]) < one["before"]
    text = (folders / "model" / "MODEL.md").read_text(encoding="utf-8")
    assert text.count("## Beside registration without a model") == 1
    assert text.endswith(beside["text"])
    assert f"| {beside['alone']['before']:.2f} | {beside['alone']['model']:.2f} |" in text
    data = tr.open_dataset(folders / "data")
    field, surface = data.displacement[5].astype(float), np.unique(data.mesh.surface)[::60]
    reference = data.mesh.nodes[surface]
    moved = reference + field[surface]
    given = tr.Markers(reference, moved, std=0.1), folders / "model"
    for simulation in (None, 0.8 * field):
        result = tr.register(data.mesh, given[0], model=given[1], simulation=simulation, targets={"t": (0, 0, 20)})
        target = result.target("t")
        assert np.linalg.eigvalsh(target.covariance).min() > 0
        assert 0.0 <= target.constrained <= 1.0
        assert np.isfinite(result.std).all()
        # Exact markers: better than the body at rest.
        assert result.markers.after_rms_mm < 0.5 * result.markers.before_rms_mm


def test_pairs_of_the_data_set_are_used_without_a_further_folder(folders, capsys):
    words = ["calibrate", str(folders / "model"), "--data", str(folders / "data"), "--json", "-"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["pairs"] == 2


def test_a_folder_without_pairs_is_refused(folders, capsys, tmp_path):
    words = ["calibrate", str(folders / "model"), "--data", str(folders / "data"), "--pairs", str(tmp_path)]
    assert main(words) == 2
    # The paragraph is broken where its line is full.
    assert "must hold files pairs_*.npz" in " ".join(capsys.readouterr().err.split())
