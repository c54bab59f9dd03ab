"""What a new user tries first: a rig is simulated here, with the noise that it states, and diagnosed."""

from dataclasses import replace

import pytest

import tissuereg as tr
from support.files import run_json
from support.rig_folders import write_rig
from tissuereg.experiment.effects import Swelling


@pytest.mark.parametrize(("pads", "words"), [("balls", []), ("sets", []), ("balls", ["--plain"])])
def test_what_is_simulated_here_without_an_effect_is_consistent(pads, words, tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", pads)
    made = tmp_path / "made"
    code, _, _ = run_json(capsys, "simulate", rig, *words, "--noise", "--seed", 1, "--out", made, "--quiet")
    assert code == 0
    code, said, _ = run_json(capsys, "diagnose", made, "--no-cache", "--quiet")
    assert code == 0
    assert (said["verdict"], said["causes"], said["left"]) == ("consistent", [], None)


def test_a_simulation_without_noise_is_consistent_too(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "sets")
    run_json(capsys, "simulate", rig, "--out", tmp_path / "made", "--quiet")
    code, said, _ = run_json(capsys, "diagnose", tmp_path / "made", "--no-cache", "--quiet")
    assert code == 0
    assert said["verdict"] == "consistent"


def test_a_plain_simulation_is_compared_with_its_own_mesh_and_not_with_a_fine_one(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "balls")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig, "--plain", "--noise", "--seed", 1, "--out", made, "--quiet")
    given = tr.read_experiment(made)
    own = tr.diagnose(given, keep=False)
    assert own.verdict == "consistent"
    assert not any(name.startswith(("size", "tilt", "mesh")) for name in own.details.nuisances.names)
    assert own.discrepancy["in_sigma"] == pytest.approx(1.0, abs=0.1)


def test_a_swelling_that_pads_follow_is_named_alone(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "balls")
    believed = tr.read_experiment(rig)
    grows = Swelling(linear_strain=0.02, from_time_s=0.0, to_time_s=46.0, pads="follow")
    tr.write_experiment(replace(believed, effects=(grows,)), rig / "grows.toml")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig / "grows.toml", "--noise", "--out", made, "--quiet")
    told = tr.diagnose(replace(tr.read_experiment(made), effects=()), keep=False)
    (finding,) = told.findings
    assert (told.verdict, finding.id, finding.parameters["pads"]) == ("named", "swelling", "follow")
    assert finding.parameters["linear_strain"] == pytest.approx(0.02, rel=0.1)


def test_what_a_named_cause_does_not_explain_is_said(tmp_path, capsys, monkeypatch):
    rig = write_rig(tmp_path / "rig", "sets")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig, "--plain", "--noise", "--out", made, "--quiet")
    given = tr.read_experiment(made)
    places = {name: case.markers.copy() for name, case in given.cases.items()}
    # One marker slips far; another one jumps in a single frame, which is no cause of the catalogue.
    for case in places.values():
        case[:, 2] += [0.0, 1.2, 0.9]
    places["side"][5, 7] += [0.9, 0.0, 0.0]
    cases = {name: replace(case, markers=places[name]) for name, case in given.cases.items()}
    told = tr.diagnose(replace(given, cases=cases), keep=False)
    assert (told.verdict, [finding.id for finding in told.findings]) == ("named", ["marker_slip"])
    assert told.findings[0].parameters["marker"] == "P2"
    assert told.left["p"] == told.p_misfit < 0.01
    assert told.left["where"][0] == "P7"
    assert f"{cases['side'].times[5]:.4g} s" in told.left["when"]
    assert told.to_json()["left"] == told.left
