"""The commands read an experiment with effects like any other, from the folder in which it was written."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json, write_experiment
from tissuereg.effects import ActuatorGain, ActuatorOffset, MarkerSwap, Relaxation, Sliding
from tissuereg.io.cases import read_histories


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    return write_experiment(tmp_path / "rig")


def extended(folder, *effects):
    """Write the experiment with effects beside its folder."""
    file = folder.parent / "found" / "experiment.extended.toml"
    tr.write_experiment(replace(tr.read_experiment(folder), effects=effects), file)
    return file


def simulated(capsys, path, out):
    code, said, err = run_json(capsys, "simulate", path, "--out", out, "--quiet")
    assert (code, err, said["failed"], said["members"]) == (0, "", [], 5)
    return read_histories(out / "markers.csv", "marker", "mm", None)["lean"]


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
    words = ["--case", "lean", "--time", 11, "--prior-members", 40, "--quiet"]
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
    held, slid = simulated(capsys, folder, tmp_path / "a"), simulated(capsys, slips, tmp_path / "b")
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
