"""The commands read an experiment with effects like any other, from the folder in which it was written."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json, write_experiment
from support.material_curves import believed, in_modes
from tissuereg.experiment.effects import ActuatorGain, ActuatorOffset, MarkerSwap, Relaxation, Sliding
from tissuereg.io.cases import read_histories
from tissuereg.io.experiment_keys import MARKERS_CSV
from tissuereg.io.material_experiments import write_test_table


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    return write_experiment(tmp_path / "rig")


def extended(folder, *effects):
    """Write the experiment with effects beside its folder."""
    file = folder.parent / "found" / "experiment.extended.toml"
    tr.write_experiment(replace(tr.read_experiment(folder), effects=effects), file)
    return file


def simulated(capsys, path, out, *words):
    code, said, err = run_json(capsys, "simulate", path, *words, "--out", out, "--quiet")
    assert (code, err, said["failed"], said["members"]) == (0, "", [], 5)
    return read_histories(out / "markers.csv", MARKERS_CSV, None)["lean"]


def test_simulate_writes_what_the_tracker_sees_of_the_extended_model(folder, tmp_path, capsys):
    swap = MarkerSwap(markers=("P1", "P2"), from_time_s=10.7)
    file = extended(folder, ActuatorGain(actuator="push", gain=2.0), swap)
    plain, found = simulated(capsys, folder, tmp_path / "a"), simulated(capsys, file, tmp_path / "b")
    reference = tr.read_experiment(folder).marker_reference
    moved = np.array(plain["P1"].values[1]) - reference[0]
    assert np.array(found["P1"].values[1]) - reference[0] == pytest.approx(2.0 * moved, abs=0.05 * np.abs(moved).max())
    # From 10.7 s on P1 is the marker on the side.
    assert np.linalg.norm(np.array(found["P1"].values[2]) - reference[1]) < 5.0


def test_register_takes_a_frame_that_went_through_time(folder, tmp_path, capsys):
    file = extended(folder, Relaxation(g=(0.3,), tau_s=(1.0,)))
    words = ["--case", "lean", "--time", 11, "--quiet"]
    code, said, _ = run_json(capsys, "register", file, *words, "--out", tmp_path / "out")
    assert code == 0
    assert said["markers"]["used"] == ["P1", "P2"]
    simulation = said["targets"]["deep"]["simulation_mm"]
    assert simulation[0] > 15.2
    code, plain, _ = run_json(capsys, "register", folder, *words, "--out", tmp_path / "plain")
    # Moved by displacements, a homogeneous body that relaxes keeps its shape to the second order of its strain.
    assert simulation == pytest.approx(plain["targets"]["deep"]["simulation_mm"], abs=0.02)


def test_simulate_lets_a_base_slip_by_friction(folder, tmp_path, capsys):
    slips = extended(folder, Sliding(boundary="base", friction=0.1, cohesion_kpa=0.02))
    held, slid = (simulated(capsys, file, tmp_path / out, "--plain") for file, out in ((folder, "a"), (slips, "b")))
    assert np.array(slid["P1"].values[1])[0] > np.array(held["P1"].values[1])[0] + 0.05


def test_what_cannot_be_simulated_is_said_by_table(folder, tmp_path, capsys):
    file = extended(folder, ActuatorOffset(actuator="push", shift_mm=(500.0, 0.0, 0.0)))
    code, _, err = run(capsys, "simulate", file, "--out", tmp_path / "sim", "--quiet")
    assert code == 2
    said = "`shift_mm` must leave the patch of 'push' on the body, got [500.0, 0.0, 0.0] in [[effect]] number 1"
    assert said in " ".join(err.split())
    assert not (tmp_path / "sim").exists()


def test_simulated_tables_never_replace_the_measured_ones(folder, capsys):
    file = extended(folder, ActuatorGain(actuator="push", gain=2.0))
    before = (folder / "markers.csv").read_bytes()
    code, _, _ = run(capsys, "simulate", file, "--out", folder, "--quiet")
    assert code == 2
    assert (folder / "markers.csv").read_bytes() == before


def test_a_diagnosis_without_measurements_is_bad_input(tmp_path, capsys):
    folder = write_experiment(tmp_path / "rig", markers=None, forces=None)
    code, said, err = run_json(capsys, "diagnose", folder, "--out", tmp_path / "out")
    assert code == 2
    assert said["schema"] == "tissuereg.error/1"
    assert "markers" in said["message"]
    assert not (tmp_path / "out").exists()
    assert "Traceback" not in err


def test_a_diagnosis_never_replaces_the_model_that_it_diagnoses(folder, capsys):
    file = extended(folder, ActuatorGain(actuator="push", gain=2.0))
    before = file.read_bytes()
    code, said, _ = run_json(capsys, "diagnose", file, "--out", file.parent, "--quiet")
    assert code == 2
    assert "must not replace an input" in said["message"]
    assert file.read_bytes() == before


def test_a_material_test_is_diagnosed_by_the_same_command(tmp_path, capsys):
    curves = in_modes(np.random.default_rng(4), ("ogden", -10.0))
    write_test_table(tmp_path / "test.csv", curves)
    tr.write_experiment(believed(curves, folder=tmp_path), tmp_path / "experiment.toml")
    code, said, _ = run_json(capsys, "diagnose", tmp_path, "--element", "tet10", "--quiet")
    assert (code, said["where"]) == (2, "--element")
    out = tmp_path / "out"
    code, said, _ = run_json(capsys, "diagnose", tmp_path, "--out", out, "--quiet")
    assert code == 0
    assert [cause["id"] for cause in said["causes"]] == ["asymmetry"]
    kept = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert {"seconds", "threads", "machine", "versions"} <= set(kept)
    assert {key: kept[key] for key in ("causes", "verdict")} == {key: said[key] for key in ("causes", "verdict")}
    assert (out / "report.html").exists()
    code, said, _ = run_json(capsys, "diagnose", out / said["extended_model"], "--quiet")
    assert (code, said["verdict"], said["extended_model"]) == (0, "consistent", None)
