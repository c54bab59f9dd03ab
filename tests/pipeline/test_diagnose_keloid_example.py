"""Measured skin with a keloid through the diagnosis, as a user runs the example, on a coarser build."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "diagnose_keloid.py"


def run(folder, drive, told):
    words = [sys.executable, str(EXAMPLE), "--data", str(folder), "--drive", drive, "--coarse", "--json", str(told)]
    subprocess.run(words, check=True, capture_output=True)
    (row,) = json.loads(told.read_text(encoding="utf-8"))["rows"]
    return row, {cause["id"]: cause for cause in row["causes"]}


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def keloid(shared_data):
    folder = shared_data / "data" / "keloid"
    if not folder.is_dir():
        pytest.skip(f"measured data are absent: {folder}")
    return folder


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("diagnose_keloid", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_the_folders_hold_the_recording_and_hide_the_regions(example, keloid, tmp_path):
    recording = example.read_recording(keloid / "keloid.npz")
    plane = example.read_plane(keloid / "mesh.msh", recording)
    last = {}
    for drive in ("images", "stroke"):
        example.write_folder(tmp_path / drive, recording, plane, drive, "fine")
        rig = tr.read_experiment(tmp_path / drive)
        case = rig.cases["pull"]
        last[drive] = case.displacements["moving_pad"][-1]
        assert set(rig.mesh.node_sets) == {"moving_pad", "fixed_pad", "sides", "fixed"}
        # The mesh of the skin, its two holes of 8 x 8 mm filled.
        assert rig.mesh.volumes.sum() == pytest.approx(100.0 * 50.0 * example.THICKNESS_MM)
        assert 600 <= rig.mesh.n_nodes <= 2500
        assert np.isnan(case.markers[..., 2]).all()
        assert np.isfinite(case.markers[..., :2]).all()
        assert np.isfinite(case.forces["moving_pad"]).all(axis=0).tolist() == [True, False, False]
        assert case.forces["moving_pad"][-1, 0] == pytest.approx(-2524.5, abs=0.1)
    # Stroke sensor and images disagree by the actuator's gain.
    assert last["images"][0] / last["stroke"][0] == pytest.approx(5.00 / 4.11, rel=0.005)
    assert last["stroke"][1] == 0.0


def test_a_place_is_told_from_the_named_regions(example, keloid):
    recording = example.read_recording(keloid / "keloid.npz")
    plane = example.read_plane(keloid / "mesh.msh", recording)
    amid, beside = example.place_of([20.0, 0.0, 2.0], plane), example.place_of([20.0, 20.0, 2.0], plane)
    assert (amid["inside"], amid["to_keloid_mm"]) == ("keloid", 0.0)
    assert beside["inside"] == "skin"
    assert beside["to_keloid_mm"] == pytest.approx(15.0, abs=0.5)


@pytest.mark.slow
def test_stiffening_comes_first_and_is_not_named_where_a_patch_foretells_frames_better(keloid, tmp_path):
    row, causes = run(keloid, "images", tmp_path / "told.json")
    assert row["provisional"]
    assert (row["verdict"], causes) == ("unexplained", {})
    assert row["p_misfit"] < 1e-10
    # The generic rival, then causes by what they gain.
    gains = {cause["id"]: cause["log_bayes_factor"] for cause in row["candidates"]}
    first, second, third = list(gains)[:3]
    assert (first, second) == ("unknown", "stiffening")
    assert gains["unknown"] > gains["stiffening"] > gains[third] + 300.0 > 1000.0
