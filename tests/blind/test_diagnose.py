"""Sealed cases of the quick tier through the command, drawn by a seed.

The scorer opens their answers after the command has spoken.
"""

import random

import pytest

from blind.materialise import materialise
from blind.run import tier_cases
from blind.scored import Scored, open_answers
from support.files import run_json

#: Cases that two minutes have room for, and how many of them must be answered exactly: on the whole bench four in five
#: are.
CASES = random.Random(2026).sample(sorted(tier_cases("quick")), 8)
EXACT = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sealed")


@pytest.fixture
def asked(folder, capsys, monkeypatch):
    """Return what the command says of a case, once asked and written down."""
    monkeypatch.setenv("TISSUEREG_CACHE", str(folder / "cache"))

    def ask(case):
        if case not in said_of:
            rig = materialise(case, folder / case)
            code, said, _ = run_json(capsys, "diagnose", rig, "--out", folder / f"{case}-out", "--quiet")
            assert code == 0
            said_of[case] = said
        return said_of[case]

    return ask


said_of: dict = {}


@pytest.mark.parametrize("case", CASES)
def test_a_sealed_case_is_answered_in_full(case, asked, folder, tmp_path, capsys):
    said = asked(case)
    assert said["schema"] == "tissuereg.diagnosis/1"
    assert (said["left"] is None) == (said["p_misfit"] >= 0.01 or not said["causes"])
    out = folder / f"{case}-out"
    assert (out / "diagnosis.json").exists()
    extended = out / "experiment.extended.toml"
    code, again, _ = run_json(capsys, "simulate", extended, "--plain", "--out", tmp_path / "sim")
    assert code == 0
    assert not again["failed"]


def test_most_sealed_cases_are_answered_exactly_and_no_body_without_an_effect_is_misnamed(asked):
    said = {case: asked(case) for case in CASES}
    answers = open_answers(set(CASES))
    scored = [Scored(case, answers[case], said[case]) for case in CASES]
    exact = [case for case in scored if case.said["verdict"] in case.truth["verdict_ok"] and case.exact]
    assert len(exact) >= EXACT
    assert not any(case.ids for case in scored if case.truth["kind"] == "null")
    # Nothing that is named first stands for another cause.
    assert not any(case.groups and not case.groups[0] & set(case.truth["group_ok"]) for case in scored)
