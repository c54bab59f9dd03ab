"""Measured brain tissue and silicones through the example scripts, as a user runs them."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(script, folder, summary):
    words = [sys.executable, str(EXAMPLES / script), "--data", str(folder), "--json", str(summary)]
    subprocess.run(words, check=True, capture_output=True)
    return json.loads(summary.read_text(encoding="utf-8"))


def need(folder):
    if not folder.is_dir():
        pytest.skip(f"measured data are absent: {folder}")
    return folder


@pytest.fixture(scope="module")
def brain(shared_data, tmp_path_factory):
    answer = run("brain.py", need(shared_data / "data" / "brain"), tmp_path_factory.mktemp("brain") / "told.json")
    return {r["region"]: {(law["law"], law["terms"]): law for law in r["laws"]} for r in answer["regions"]}


def test_the_published_misfit_of_brain_tissue_is_found(brain):
    for region, weighted, plain, ogden, alpha in (
        ("cortex", 0.43, 0.85, 1.00, -19.0),
        ("corona_radiata", -0.02, 0.75, 0.95, -23.0),
    ):
        base, best = brain[region]["neo-hookean", 1], brain[region]["ogden", 1]
        assert base["r2"]["compression"] == pytest.approx(weighted, abs=0.006)
        assert base["r2_plain_least_squares"]["compression"] == pytest.approx(plain, abs=0.006)
        assert best["r2"]["compression"] == pytest.approx(ogden, abs=0.006)
        assert best["shape"]["alpha"][0] == pytest.approx(alpha, abs=0.6)


def test_a_mode_that_was_left_out_is_predicted_better(brain):
    for laws in brain.values():
        gains = laws["ogden", 1]["held_out_gain"]
        assert set(gains) == {"tension", "compression", "simple-shear"}
        assert all(1.5 < gain < 15 for gain in gains.values())


def test_regions_are_read_by_their_files(shared_data, tmp_path):
    source = need(shared_data / "data" / "brain")
    for name in ("tension", "compression"):
        shutil.copy(source / f"cortex_{name}.txt", tmp_path / f"left_putamen_{name}.txt")
    (only,) = run("brain.py", tmp_path, tmp_path / "told.json")["regions"]
    assert only["region"] == "left_putamen"
    assert only["modes"] == ["tension", "compression"]
    assert set(only["laws"][0]["held_out_rms_kpa"]) == {"tension", "compression"}


def test_the_published_errors_of_a_silicone_are_found(shared_data, tmp_path):
    source = need(shared_data / "data" / "silicone")
    for specimen in ("A1", "B1"):
        shutil.copy(source / f"EF10_0T_{specimen}.csv", tmp_path / f"EF99_7T_{specimen}.csv")
    (silicone,) = run("silicone.py", tmp_path, tmp_path / "told.json")["silicones"]
    assert silicone["silicone"] == "EF99_7T"
    for file in silicone["files"]:
        errors = {law: fit["standard_error_kpa"] for law, fit in file["laws"].items()}
        assert errors["neo-hookean"] == pytest.approx(13.4, abs=0.5)
        assert min(errors.values()) == pytest.approx(0.65, abs=0.1)
    held_out = silicone["specimen_left_out_rms_kpa"]
    assert all(held_out["yeoh"][s] < 0.3 * held_out["neo-hookean"][s] for s in "AB")
