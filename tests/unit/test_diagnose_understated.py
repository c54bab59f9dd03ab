"""Noise that is larger than stated: a verdict of its own, and no cover for effects."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run_json
from support.rig_folders import write_rig
from tissuereg.cli import main
from tissuereg.diagnosis.noise import scale_evidence
from tissuereg.diagnosis.report.words import summary
from tissuereg.diagnosis.settings import DEFAULT


@pytest.fixture(scope="module")
def null(tmp_path_factory):
    folder = tmp_path_factory.mktemp("null")
    rig = write_rig(folder / "rig", "sets")
    main(["simulate", str(rig), "--plain", "--noise", "--seed", "1", "--out", str(folder / "made"), "--quiet"])
    return tr.read_experiment(folder / "made")


def stated(given, markers=1.0, forces=1.0, *, rest=True):
    """Return an experiment whose noise is stated so many times too small, with or without frames at rest."""
    given = replace(given, marker_std=given.marker_std / markers, force_std=given.force_std / forces)
    if rest:
        return given
    cases = {name: case for name, case in given.cases.items() if name != given.rest_case}
    return replace(given, cases=cases, rest_case=None)


@pytest.mark.parametrize("rest", [True, False])
@pytest.mark.parametrize(("markers", "forces"), [(1.0, 1.0), (3.0, 1.0), (10.0, 1.0), (1.0, 3.0), (10.0, 10.0)])
def test_noise_that_is_stated_too_small_is_a_verdict_of_its_own(null, markers, forces, rest):
    found = tr.diagnose(stated(null, markers, forces, rest=rest), keep=False)
    assert found.findings == ()
    assert found.p_misfit > 0.01
    too_small = {name: factor for name, factor in (("markers", markers), ("forces", forces)) if factor > 1.0}
    assert found.verdict == ("understated-noise" if too_small else "consistent")
    assert {one.channel for one in found.understated} == set(too_small)
    for one in found.understated:
        # Some hundred numbers determine a standard deviation to a twentieth.
        assert one.factor == pytest.approx(too_small[one.channel], rel=0.15)
        assert one.log_bayes_factor > DEFAULT.noise.least_evidence
    said = found.to_json()["understated_noise"]
    assert [one["channel"] for one in said] == [one.channel for one in found.understated]
    assert ("understated" in summary(found)) == bool(too_small)
    assert ("state a noise of" in summary(found)) == bool(too_small)


def test_what_is_no_noise_is_not_taken_for_it(null):
    rng = np.random.default_rng(0)
    given = stated(null, rest=False)
    walks = {
        name: replace(case, markers=case.markers + np.cumsum(0.03 * rng.standard_normal(case.markers.shape), axis=0))
        for name, case in given.cases.items()
    }
    jumps = {name: replace(case, markers=case.markers.copy()) for name, case in given.cases.items()}
    for case in jumps.values():
        case.markers[:, 3] += 0.5 * rng.standard_normal(case.markers[:, 3].shape)
    for cases in (walks, jumps):
        found = tr.diagnose(replace(given, cases=cases), keep=False)
        assert (found.verdict, found.understated) == ("unexplained", ())


def test_the_evidence_allows_a_statement_to_be_a_little_off():
    rules = DEFAULT.noise
    for freedom in (50.0, 500.0, 5000.0):
        assert scale_evidence(freedom, freedom, rules) < 0.0
        assert scale_evidence(1.05**2 * freedom, freedom, rules) < rules.least_evidence
        assert scale_evidence(3.0**2 * freedom, freedom, rules) > rules.least_evidence


def test_the_command_says_it(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "sets")
    run_json(capsys, "simulate", rig, "--plain", "--noise", "--seed", 2, "--out", tmp_path / "made", "--quiet")
    file = tmp_path / "made" / "experiment.toml"
    text = file.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("std_mm"))
    std = float(line.split("=")[1])
    file.write_text(text.replace(line, f"std_mm = {std / 5.0}"), encoding="utf-8")
    code, said, _ = run_json(capsys, "diagnose", tmp_path / "made", "--no-cache", "--quiet")
    assert (code, said["verdict"], said["causes"]) == (0, "understated-noise", [])
    (one,) = said["understated_noise"]
    assert one["estimated"] == pytest.approx(std, rel=0.15)
