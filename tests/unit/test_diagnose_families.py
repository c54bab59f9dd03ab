"""Families of causes: where the data hold a cause, and where no more than its family."""

import argparse
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from support.targets import finding_of, part, target_of
from tissuereg.cli import diagnose as command
from tissuereg.cli.common import Stopwatch
from tissuereg.diagnosis.answer import verdict_of
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.base import Cause
from tissuereg.diagnosis.constancy import FAMILIES, AfterFit, FittedPart, Membership, fitted_parts, memberships
from tissuereg.diagnosis.evidence import Blocks, Null, log_mean_exp, tail_probability
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.report.page import finding_section, verdict_sentence
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.experiment.effects import Poisson

SIZE = 40


def test_the_families_are_those_of_the_page():
    text = (Path(__file__).parents[2] / "docs" / "diagnose.md").read_text(encoding="utf-8")
    rows = [re.findall(r"`(\w+)`", row) for row in re.findall(r"^\| [^|]+ \| (`.*`) \|$", text, re.MULTILINE)]
    stated = {frozenset(ids) for ids in rows if ids and set(ids) <= set(CAUSES)}
    families = {name: {i for i, cause in CAUSES.items() if cause.family == name} for name in FAMILIES}
    assert stated == {frozenset(ids) for ids in families.values()}, "the table of causes in docs/diagnose.md"


def test_a_cause_without_a_family_is_refused():
    with pytest.raises(TypeError, match="the cause 'homeless' must state its `family`"):
        type("Homeless", (Cause,), {"id": "homeless"})


def left_of(seed, along=None):
    """Return what a fit leaves, noise and 400 draws of it; `along`: something else that the residual has."""
    rng = np.random.default_rng(seed)
    residual = rng.standard_normal(SIZE) + (0.0 if along is None else along)
    return AfterFit(residual, rng.standard_normal((400, SIZE)), np.zeros((0, SIZE)))


def screen_of(**columns):
    """Return a screen of causes with one hypothesis for each of their columns."""
    blocks = {name: Blocks(np.asarray(rows, np.float32)[:, None]) for name, rows in columns.items()}
    return SimpleNamespace(blocks=blocks)


def judged(left, screen, name="relaxation", beside=(), unlike=(), settings=DEFAULT.constancy):
    made = FittedPart(name, beside, left, Null(np.zeros((0, SIZE))), list(unlike))
    return memberships([made], screen, settings).get(0)


def test_what_looks_like_a_relative_leaves_the_family_alone():
    looks = 8.0 * np.eye(SIZE)[3]
    screen = screen_of(rate=[looks], frame=[8.0 * np.eye(SIZE)[5]])
    found = judged(left_of(0, looks), screen)
    assert not found.holds
    assert found.p < 1e-4
    assert found.to_json() == {
        "id": "memory", "words": "effects of time and load history", "p": found.p, "alone": True,
        "reason": f"what it leaves looks like another one of them (p = {found.p:.1g})",
    }  # fmt: skip
    assert judged(left_of(0), screen).holds
    beaten = Membership("inclusion", 0.4, 0.05, beaten=True)
    assert not beaten.holds
    assert beaten.to_json()["reason"] == "one of them that the catalogue lacks explains the data as well"
    assert "reason" not in Membership("inclusion", 0.4, 0.05).to_json()
    # Neither another family nor a cause that was found too is a relative.
    assert judged(left_of(0, 8.0 * np.eye(SIZE)[5]), screen).holds
    assert judged(left_of(0, looks), screen, beside=("rate",)) is None
    assert judged(left_of(0, looks), screen_of(frame=[looks])) is None
    # What a slip leaves is something beside it.
    assert judged(left_of(0, looks), screen_of(frame=[looks]), "marker_slip") is None
    assert not judged(left_of(0, looks), screen_of(frame=[looks]), "latency").holds


def test_p_values_of_a_member_are_uniform():
    rng = np.random.default_rng(5)
    screen = screen_of(rate=rng.standard_normal((3, SIZE)), set=rng.standard_normal((2, SIZE)))
    found = np.array([judged(left_of(seed), screen).p for seed in range(80)])
    assert 0.4 < found.mean() < 0.6
    assert np.mean(found < 0.2) == pytest.approx(0.2, abs=0.12)


def test_each_of_two_causes_of_one_id_is_tested_by_what_it_leaves_itself():
    looks, nothing = 8.0 * np.eye(SIZE)[3], Null(np.zeros((0, SIZE)))
    parts = [FittedPart("inclusion", (), left_of(0, along), nothing, [], at) for at, along in ((1, looks), (2, None))]
    found = memberships(parts, screen_of(layer=[looks]), DEFAULT.constancy)
    assert {at: one.holds for at, one in found.items()} == {1: False, 2: True}


def test_members_count_alike_and_inconstancy_counts_as_all_of_them():
    left, rng = left_of(1), np.random.default_rng(2)
    rows = {"rate": rng.standard_normal((9, SIZE)), "set": rng.standard_normal((1, SIZE))}

    def evidence(row):
        least = DEFAULT.constancy.least_change * np.linalg.norm(row)
        return left.evidence(row[None], least, DEFAULT.constancy)

    of_members = [log_mean_exp(np.array([evidence(row) for row in each]), axis=0) for each in rows.values()]
    relatives = log_mean_exp(np.array(of_members), axis=0)
    assert judged(left, screen_of(**rows)).p == pytest.approx(tail_probability(relatives[0], relatives[1:]), rel=1e-3)
    unlike = [("time", 0.1 * relatives), ("load case", 0.7 * relatives)]
    both = log_mean_exp(np.array([relatives, log_mean_exp(np.array([one for _, one in unlike]), axis=0)]), axis=0)
    found = judged(left, screen_of(**rows), unlike=unlike)
    assert found.p == pytest.approx(tail_probability(both[0], both[1:]), rel=1e-3)
    # Without relatives the inconstancy alone decides.
    alone = judged(left, screen_of(), unlike=unlike[:1])
    assert alone.p == pytest.approx(tail_probability(unlike[0][1][0], unlike[0][1][1:]))


def test_errors_of_the_other_causes_are_no_sign_of_a_relative():
    looks, rng = 8.0 * np.eye(SIZE)[3] + np.eye(SIZE)[7], np.random.default_rng(3)
    errors = Null(50.0 * np.eye(SIZE)[3:4])
    residual, draws = rng.standard_normal(SIZE) + looks, rng.standard_normal((400, SIZE))
    left = AfterFit(errors.reduced(residual), draws, np.zeros((0, SIZE)))
    made = FittedPart("relaxation", ("latency",), left, errors, [])
    found = memberships([made], screen_of(rate=[looks]), DEFAULT.constancy)[0].p
    assert found > 0.05
    # What the errors cannot make of the relative's change is e_7.
    expected = left.evidence(np.eye(SIZE)[7:8], 0.0, DEFAULT.constancy)
    assert found == pytest.approx(tail_probability(expected[0], expected[1:]), rel=0.05)
    without = replace(made, left=replace(left, residual=residual), errors=Null(np.zeros((0, SIZE))))
    assert not memberships([without], screen_of(rate=[looks]), DEFAULT.constancy)[0].holds


def test_a_law_that_stands_for_another_one_is_stated_as_a_law():
    # With a catalogue of two laws, the true one left out of the second fit.
    found = {}
    for name in ("poisson", "asymmetry"):
        target = target_of(Poisson(poisson=0.47), marker_std=0.005)
        bank = {one: list(CAUSES[one].variants(target.bench)) for one in ("mooney", "stiffening", "latency")}
        by_modulus = target.white(target.bench.young_spread * target.bench.by_young[:1])
        null = Null(np.where(target.bench.layout.seen, by_modulus, 0.0))
        layout = target.bench.layout
        screen = Screen(bank, np.zeros((1, 1, layout.size)), target.noise, layout, target.correction, null)
        fitted = fit(target, [part(target, name)])
        draws = np.stack([target.noise.draw(layout, np.random.default_rng([2, k])) for k in range(200)])
        parts = fitted_parts(target, fitted, null, null.reduced(draws), 0, DEFAULT.constancy)
        found[name] = memberships(parts, screen, DEFAULT.constancy)[0]
    assert found["poisson"].holds
    assert found["poisson"].p > 0.1
    assert not found["asymmetry"].holds


def stated(p, *, group=("relaxation",)):
    member = Membership("relaxation", p, 0.05)
    return finding_of(group, parameters={"g": [0.4]}, sentence="Stress relaxes.", membership=member)


def test_a_family_alone_is_no_name():
    assert verdict_of([stated(0.5)], 0.5, withdrawn=False) == "named"
    assert verdict_of([stated(0.001)], 0.5, withdrawn=False) == "group"
    assert verdict_of([stated(0.5, group=("relaxation", "rate"))], 0.5, withdrawn=False) == "group"
    assert verdict_of([replace(stated(0.5), membership=None)], 0.5, withdrawn=False) == "named"


def test_a_family_alone_is_said_by_page_and_command():
    found = SimpleNamespace(verdict="group", findings=(stated(0.001),), suspicions=(), candidates=())
    assert "one of the effects of time and load history (best: relaxation)" in verdict_sentence(found)
    assert "hold its family alone, effects of time and load history" in finding_section(stated(0.001))
    assert "family alone" not in finding_section(stated(0.5))
    for p, said in ((0.001, True), (0.5, False)):
        answer = {
            "verdict": "group",
            "p_misfit": 0.4,
            "causes": [stated(p).to_json()],
            "possible": [],
        }
        args = argparse.Namespace(verbose=False, out=None, exit_code=False, threads=1)
        text = command._outcome(answer, Stopwatch(), args).summary
        assert ("or another one of the effects of time and load history" in text) is said
