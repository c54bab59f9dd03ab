"""Sealed cases of the quick tier through the command, drawn by a seed.

The scorer opens their answers after the predictions are written.
"""

import random

import pytest

from blind.materialise import materialise
from blind.run import tier_cases
from blind.scored import Scored, open_answers
from support.files import run_json

#: Cases that fit in two minutes, and how many of them must be answered exactly: on the whole bench four in five are.
CASES = random.Random(2026).sample(sorted(tier_cases("quick")), 8)
EXACT = 6


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sealed")


@pytest.fixture
def answer_to(folder, capsys, monkeypatch):
    """Return a function that diagnoses a case by the command, once per session."""
    monkeypatch.setenv("TISSUEREG_CACHE", str(folder / "cache"))

    def answer(case):
        if case not in answers:
            rig = materialise(case, folder / case)
            code, found, _ = run_json(capsys, "diagnose", rig, "--out", folder / f"{case}-out", "--quiet")
            assert code == 0
            answers[case] = found
        return answers[case]

    return answer


answers: dict = {}


@pytest.mark.parametrize("case", CASES)
def test_a_sealed_case_is_answered_in_full(case, answer_to, folder, tmp_path, capsys):
    found = answer_to(case)
    assert found["schema"] == "tissuereg.diagnosis/1"
    assert (found["left"] is None) == (found["p_misfit"] >= 0.01 or not found["causes"])
    out = folder / f"{case}-out"
    assert (out / "diagnosis.json").exists()
    extended = out / "experiment.extended.toml"
    code, again, _ = run_json(capsys, "simulate", extended, "--plain", "--out", tmp_path / "sim")
    assert code == 0
    assert not again["failed"]


def test_most_sealed_cases_are_answered_exactly_and_no_body_without_an_effect_is_misnamed(answer_to):
    predictions = {case: answer_to(case) for case in CASES}
    truth = open_answers(set(CASES))
    scored = [Scored(case, truth[case], predictions[case]) for case in CASES]
    exact = [case for case in scored if case.prediction["verdict"] in case.truth["verdict_ok"] and case.exact]
    assert len(exact) >= EXACT
    assert not any(case.ids for case in scored if case.truth["kind"] == "null")
    # The cause that is named first is never a wrong one.
    assert not any(case.groups and not case.groups[0] & set(case.truth["group_ok"]) for case in scored)
