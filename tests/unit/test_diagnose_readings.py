"""Recordings in other units, axes or signs are named before any cause; right ones are not suspected."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rigs import rig
from tissuereg.cli import main
from tissuereg.diagnosis.readings import suspect_recording
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.simulation.experiment import simulate_plain, with_noise


@pytest.fixture(scope="module")
def right():
    """A rig twice as stiff and less compressible than believed, with noise."""
    believed = rig()
    true = replace(believed, material=tr.Material(young=20.0, poisson=0.45))
    answers = with_noise(believed, simulate_plain(true, threads=1), seed=1)
    cases = {
        name: replace(case, markers=answers[name].markers, forces=answers[name].forces)
        for name, case in believed.cases.items()
    }
    return replace(believed, cases=cases)


def suspected(experiment):
    return suspect_recording(experiment, SignalLayout(experiment), element="tet4", threads=1)


def turned(experiment, turn, *channels):
    """The experiment with a linear map on some of its channels."""
    turn = turn * np.eye(3) if np.isscalar(turn) else np.asarray(turn)

    def mapped(case, name):
        given = getattr(case, name)
        return {key: one @ turn.T for key, one in given.items()} if isinstance(given, dict) else given @ turn.T

    cases = {
        title: replace(case, **{name: mapped(case, name) for name in channels})
        for title, case in experiment.cases.items()
    }
    return replace(experiment, cases=cases)


def test_a_right_recording_of_another_modulus_is_not_suspected(right):
    assert suspected(right) == []


@pytest.mark.parametrize(
    ("turn", "channels", "kind", "words"),
    [
        (1e-3, ["forces"], "unit", "forces.csv read in N (times 1000)"),
        (0.1, ["displacements"], "unit", "actuators.csv read in cm (times 10)"),
        (np.diag([1.0, 1.0, -1.0]), ["displacements"], "sign", "actuators.csv read as (x, y, -z)"),
        (np.eye(3)[[1, 2, 0]], ["markers", "displacements", "forces"], "frame", "forces.csv read as (z, x, y)"),
    ],
)
def test_another_unit_frame_or_sign_is_named_with_what_to_write(right, turn, channels, kind, words):
    (found,) = suspected(turned(right, turn, *channels))
    assert found.kind == kind
    assert words in found.sentence
    assert found.write
    assert found.log_odds > np.log(1000.0)


@pytest.mark.parametrize(
    ("lengths", "files"),
    [
        (["displacements"], ("actuators.csv", "forces.csv")),
        (["displacements", "markers"], ("[markers.reference]", "markers.csv", "actuators.csv", "forces.csv")),
    ],
)
def test_metres_together_with_newtons_are_named(right, lengths, files):
    wrong = turned(turned(right, 1e-3, *lengths), 1e-3, "forces")
    if "markers" in lengths:
        wrong = replace(wrong, marker_reference=1e-3 * wrong.marker_reference)
    (found,) = suspected(wrong)
    assert (found.kind, found.files) == ("unit", files)
    assert "actuators.csv read in m (times 1000), forces.csv read in N (times 1000)" in found.sentence


def test_all_lengths_in_another_unit_are_named(right):
    wrong = turned(right, 0.1, "displacements", "markers")
    (found,) = suspected(replace(wrong, marker_reference=0.1 * wrong.marker_reference))
    assert (found.kind, found.files) == ("unit", ("[markers.reference]", "markers.csv", "actuators.csv"))
    assert "e+" not in found.sentence  # no ratio to a prediction of nothing


def test_one_pad_with_a_wrong_sign_is_named_alone(right):
    case = right.cases["down"]
    wrong = replace(case, forces={"top": -case.forces["top"]})
    (found,) = suspected(replace(right, cases={**right.cases, "down": wrong}))
    assert "forces.csv of top read as (-x, -y, -z)" in found.sentence


def test_forces_of_noise_alone_are_silent_and_no_unit_is_blamed(right):
    (found,) = suspected(turned(right, 0.0, "forces"))
    assert (found.kind, found.log_odds) == ("silent", None)
    assert "top, side" in found.sentence


def test_a_misread_recording_is_answered_without_causes(right, tmp_path):
    found = tr.diagnose(turned(right, 1e-3, "forces"), threads=1, keep=False)
    assert (found.verdict, found.findings, found.extended.effects) == ("unexplained", (), ())
    told = found.to_json()
    assert told["suspicions"][0]["files"] == ["forces.csv"]
    assert told["next_experiment"]["action"].startswith("multiply the columns x_mN, y_mN, z_mN by 1000 in forces.csv")
    assert "probably misread" in found.report(tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_shared_case_in_newtons_is_told_so(shared_data):
    folder = shared_data / "cases" / "force-units" / "rig_newton"
    if not folder.exists():
        pytest.skip(f"needs {folder}")
    found = tr.diagnose(tr.read_experiment(folder), threads=1, keep=False)
    assert found.findings == ()
    assert "forces.csv read in N (times 1000)" in found.suspicions[0].sentence


@pytest.mark.parametrize(("options", "code"), [([], 0), (["--exit-code"], 4)])
def test_the_exit_code_speaks_of_the_verdict_only_if_asked(right, tmp_path, monkeypatch, options, code):
    wrong = turned(right, 1e-3, "forces")
    monkeypatch.setattr("tissuereg.io.experiments.read_experiment", lambda path: wrong)
    (tmp_path / "experiment.toml").write_text("")
    assert main(["diagnose", str(tmp_path), "--quiet", "--threads", "1", *options]) == code
