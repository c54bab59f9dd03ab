"""Noise that is larger than stated: a verdict of its own, and no cover for effects."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run_json
from support.rig_folders import write_rig
from support.targets import FORCE_STD, MARKER_STD, target_of
from tissuereg.cli import main
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.noise import larger_noise, scale_evidence, understated
from tissuereg.diagnosis.report.page import summary
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


def test_the_verdict_follows_the_rules_of_noise_given(null):
    given = stated(null, markers=3.0, rest=False)
    deaf = tr.diagnose(given, keep=False, settings=replace(DEFAULT, noise=replace(DEFAULT.noise, least_factor=50.0)))
    assert (deaf.verdict, deaf.understated) == ("unexplained", ())
    assert any(effect.id == "stiffness" for effect in deaf.extended.effects)


def test_the_verdict_and_the_extended_model_follow_the_levels_given(null):
    strict = replace(DEFAULT, nulls=replace(DEFAULT.nulls, misfit=1.0),
                     search=replace(DEFAULT.search, known_modulus=1e-9))  # fmt: skip
    found = tr.diagnose(null, keep=False, settings=strict)
    assert found.verdict == "unexplained"
    assert not any(effect.id == "stiffness" for effect in found.extended.effects)


def test_the_evidence_allows_a_statement_to_be_a_little_off():
    rules = DEFAULT.noise
    for freedom in (50.0, 500.0, 5000.0):
        assert scale_evidence(freedom, freedom, rules) < 0.0
        assert scale_evidence(1.05**2 * freedom, freedom, rules) < rules.least_evidence
        assert scale_evidence(3.0**2 * freedom, freedom, rules) > rules.least_evidence


RULES = DEFAULT.noise


def assumed(markers=1.0, forces=1.0, n_nuisances=0):
    """Return a target of data without any effect whose noise is assumed so many times too small."""
    target = target_of()
    size = target.bench.layout.size
    free = 100.0 * np.random.default_rng(5).standard_normal((n_nuisances, size))
    stated = MARKER_STD / markers, FORCE_STD / forces
    target.bench.experiment = replace(target.bench.experiment, marker_std=stated[0], force_std=stated[1])
    noise = replace(target.noise, marker_std=np.full(len(target.noise.marker_std), stated[0]), force_std=stated[1])
    return replace(target, noise=noise, null=Null(free))


def found_in(target, generic=None, rules=RULES):
    size = target.bench.layout.size
    found, bench = fit(target, []), target.bench
    more = np.zeros((1, size)) if generic is None else generic
    rows = np.concatenate([target.null.nuisances, target.slopes(found), more])
    return larger_noise(target.noise, bench.experiment, bench.layout, found.residual, rows, rules)


@pytest.mark.parametrize("n_nuisances", [0, 150])
@pytest.mark.parametrize(("markers", "forces"), [(1.0, 1.0), (1.15, 1.15), (3.0, 1.0), (1.0, 4.0), (2.0, 3.0)])
def test_the_factor_on_the_noise_is_found_whatever_share_of_it_the_model_takes(markers, forces, n_nuisances):
    target = assumed(markers, forces, n_nuisances)
    found = found_in(target)
    large = [factor for factor in (markers, forces) if factor > 1.2]
    if not large:
        assert found is None
        return
    # Some 100 and 20 degrees of freedom are left at least: standard deviations within a fifth and a third. Nuisances
    # that act on both do not make the noise of one that of the other.
    markers, forces = (factor if factor > 1.2 else 1.0 for factor in (markers, forces))
    np.testing.assert_allclose(found.marker_std / target.noise.marker_std, markers, rtol=0.2)
    assert found.force_std / target.noise.force_std == pytest.approx(forces, rel=0.35)
    assert (found.evidence > RULES.least_evidence) == (markers > 1.0)
    assert (found.force_evidence > RULES.least_evidence) == (forces > 1.0)


def test_what_the_generic_rival_can_change_is_no_noise():
    target = assumed()
    layout = target.bench.layout
    smooth = np.zeros((3, layout.size))
    for part in layout.parts:
        for axis in range(3):
            part.markers(smooth)[axis, ..., axis] = 1.0
    layout.measured[:] += 0.05 * np.where(layout.of_markers(), smooth.sum(axis=0), 0.0)
    assert found_in(target) is not None
    assert found_in(target, 1e-3 * smooth) is None


def test_one_marker_that_jumps_is_no_noise_of_all():
    target = assumed()
    for part in target.bench.layout.parts:
        part.markers(target.bench.layout.measured)[:, 2] *= -3.0
    assert found_in(target) is None


def test_the_rules_of_understated_noise_are_those_given():
    target = assumed(markers=2.0)
    found = found_in(target)
    assert found is not None
    for changed in (
        {"least_factor": 2.6},
        {"least_evidence": found.evidence + 1.0},
        {"least_freedom": 1e4},
        {"spread": 2.0},
    ):
        assert found_in(target, rules=replace(RULES, **changed)) is None, changed
    wide = replace(target, noise=replace(target.noise, common_std=0.01))
    more = found_in(wide)
    assert more.common_std / 0.01 == pytest.approx(more.marker_std[0] / wide.noise.marker_std[0])


def test_evidence_for_a_larger_noise_is_that_against_the_statement():
    # Rest frames have shown a factor of two, and the residual shows two again.
    target = assumed(markers=2.0)
    alone = found_in(target).evidence
    stated = replace(target.bench.experiment, marker_std=float(target.noise.marker_std[0]) / 2.0)
    target.bench.experiment = stated
    found = found_in(replace(target, noise=replace(target.noise, evidence=7.0)))
    (one,) = understated(stated, found, RULES)
    assert (one.channel, one.unit) == ("markers", "mm")
    assert one.factor == pytest.approx(4.0, rel=0.15)
    assert one.factor == pytest.approx(one.estimated / one.stated)
    assert one.log_bayes_factor == found.evidence > 2.0 * alone


@pytest.mark.parametrize(("factor", "evidence", "named"), [(1.26, 6.1, True), (1.24, 99.0, False), (3.0, 5.9, False)])
def test_a_channel_is_understated_by_the_least_factor_with_the_least_evidence(factor, evidence, named):
    target = target_of()
    given = replace(target.bench.experiment, marker_std=MARKER_STD, force_std=FORCE_STD)
    for channel, changed in (
        ("markers", {"marker_std": factor * target.noise.marker_std, "evidence": evidence}),
        ("forces", {"force_std": factor * FORCE_STD, "force_evidence": evidence}),
    ):
        said = understated(given, replace(target.noise, **changed), RULES)
        assert [one.channel for one in said] == ([channel] if named else [])
    assert understated(replace(given, force_std=None), replace(target.noise, force_std=99.0, force_evidence=9.0),
                       RULES) == ()  # fmt: skip


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
