"""The scorer on made-up answers and predictions: each figure counts what its name says."""

import json

import pytest

from blind import run
from blind.materialise import case_names
from blind.score import Scored, calibration_error, confusion, gains, power, report, rows, wilson


def truth(kind="single", cause=("layer",), **rest):
    base = {
        "kind": kind,
        "cause": list(cause),
        "group_ok": sorted({*cause, *rest.pop("near", ())}),
        "outside": [],
        "detectability": 13.0,
        "level": 13.0,
        "separable": True,
        "own_form": True,
        "noise": "white",
    }
    return base | rest


def named(*ids, group=None, probability=0.95, **held_out):
    causes = [{"id": i, "group": group or [i], "probability": probability, "held_out": held_out} for i in ids]
    return {"verdict": "group" if group else "named", "causes": causes, "seconds": 1.0}


CONSISTENT = {"verdict": "consistent", "causes": []}
UNEXPLAINED = {"verdict": "unexplained", "causes": []}


def figure(cases, name, oracle=None, without=None):
    return next(row for row in rows(cases, oracle or {}, without or {}) if row.figure == name)


def counted(cases, name, **rest):
    row = figure(cases, name, **rest)
    return row.hits, row.n


def test_a_finding_on_a_null_is_a_false_alarm():
    nulls = [
        Scored("b1", truth("null", (), group_ok=[]), CONSISTENT),
        Scored("b2", truth("null", (), group_ok=[]), named("layer")),
    ]
    assert counted(nulls, "false alarms on nulls") == (1, 2)
    assert counted(nulls, "nulls answered consistent") == (1, 2)


def test_the_hidden_id_alone_is_exact_and_a_tied_id_is_the_right_group():
    cases = [
        Scored("b1", truth(near=("poisson",)), named("layer")),
        Scored("b2", truth(near=("poisson",)), named("poisson")),
        Scored("b3", truth(near=("poisson",)), named("poisson", group=["poisson", "layer"])),
        Scored("b4", truth(near=("poisson",)), named("fibre")),
        Scored("b5", truth(near=("poisson",)), named("layer", "fibre")),
    ]
    assert [c.right for c in cases] == [True, True, True, False, False]
    assert [c.exact for c in cases] == [True, False, False, False, False]
    assert [c.wrong for c in cases] == [False, False, False, True, True]


def test_weak_and_inseparable_effects_do_not_count_as_separable():
    cases = [
        Scored("b1", truth(), named("layer")),
        Scored("b2", truth(detectability=5.0), CONSISTENT),
        Scored("b3", truth(separable=False), CONSISTENT),
    ]
    assert counted(cases, "singles, d >= 8, separable: right group") == (1, 1)
    assert counted(cases, "wrong group named, all singles") == (0, 3)


def test_an_effect_outside_the_catalogue_is_unexplained_or_misnamed():
    outside = truth("outside", (), outside=["?"], group_ok=[])
    cases = [
        Scored("b1", outside, UNEXPLAINED),
        Scored("b2", outside, named("layer")),
        Scored("b3", outside, CONSISTENT),
    ]
    assert counted(cases, "outside the catalogue: silently misnamed") == (1, 3)
    assert counted(cases, "outside, d >= 13: unexplained") == (1, 3)


def test_a_cause_taken_out_is_misnamed_only_outside_its_group():
    without = {
        "layer": [Scored("b1", truth(near=("poisson",)), named("poisson")), Scored("b2", truth(), named("fibre"))]
    }
    assert counted([], "a cause taken out: silently misnamed", without=without) == (1, 2)


def test_gain_is_relative_to_the_fit_that_was_told():
    case = Scored("b1", truth(), named("layer", chi_base=3.0, chi_named=1.2, chi_generic=2.0))
    told = {"b1": named("layer", chi_named=1.0)}
    assert gains([case], told) == ([pytest.approx(0.9)], 0)
    assert counted([case], "named cause beats the generic patch") == (1, 1)
    tiny = Scored("b2", truth(), named("layer", chi_base=1.001, chi_named=1.0))
    assert gains([tiny], {}) == ([], 1)


def test_pairs_count_when_both_are_named_and_nothing_else():
    pair = truth("pair", ("layer", "scale"))
    cases = [
        Scored("b1", pair, named("layer", "scale")),
        Scored("b2", pair, named("layer")),
        Scored("b3", pair, named("layer", "fibre")),
    ]
    assert counted(cases, "pairs: all named") == (1, 3)
    assert counted(cases, "pairs: one right and none wrong") == (2, 3)


def test_a_tied_cause_wants_its_group_and_no_more_than_three_ids():
    tied = truth("tied", near=("poisson", "sliding"))
    cases = [
        Scored("b1", tied, named("poisson", group=["poisson", "layer"])),
        Scored("b2", tied, named("layer")),
        Scored("b3", tied, named("layer", group=["layer", "a", "b", "c"])),
    ]
    assert counted(cases, "tied causes: the group named") == (1, 3)


def test_a_stated_probability_is_held_against_the_group():
    cases = [
        Scored("b1", truth(), named("layer")),
        Scored("b2", truth(), named("fibre")),
        Scored("b3", truth(), named("fibre", probability=0.6)),
    ]
    assert counted(cases, "stated probability >= 0.9: right") == (1, 2)


def test_calibration_error_is_the_gap_between_stated_and_right():
    cases = [Scored(f"b{k}", truth(), named("layer" if k < 3 else "fibre", probability=0.95)) for k in range(4)]
    assert calibration_error(cases) == pytest.approx(0.2)


def test_power_and_confusion_count_by_cause():
    cases = [Scored("b1", truth(), named("layer")), Scored("b2", truth(), CONSISTENT)]
    assert power(cases) == {"layer": {13.0: (1, 2)}}
    assert dict(confusion(cases)["layer"]) == {"layer": 1, "consistent": 1}
    assert "| layer | 1/2 |" in report(cases, {}, {})


def test_wilson_interval_of_a_known_share():
    # Newcombe, Statistics in Medicine 17, 1998, Table I: 15 of 148.
    assert wilson(15, 148) == (pytest.approx(0.0624, abs=1e-4), pytest.approx(0.1605, abs=1e-4))


def test_a_run_that_was_stopped_goes_on_and_asks_nobody_twice(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(run, "_asked", lambda diagnoser, folder, out: asked.append(folder.name) or dict(CONSISTENT))
    case = case_names()[0]
    for _ in range(2):
        answer = run.diagnose(case, "any", tmp_path / "predictions", tmp_path)
    assert asked == [case]
    assert answer["verdict"] == "consistent"
    assert json.loads((tmp_path / "predictions" / f"{case}.json").read_text(encoding="utf-8")) == answer


def test_a_diagnoser_that_fails_is_an_answer_too(tmp_path):
    answer = run.diagnose(case_names()[0], "false {folder}", tmp_path / "predictions", tmp_path)
    assert answer["verdict"] == "failed"
    assert "exit status 1" in answer["error"]
