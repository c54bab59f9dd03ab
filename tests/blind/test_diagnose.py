"""Sealed cases of the quick tier through the command, those that two minutes have room for.

The scorer opens their answers after the command has spoken.
"""

import pytest

from blind.materialise import materialise
from blind.scored import open_answers
from support.files import run_json

#: Five with an effect and three without on five rigs, of the quick tier's fastest that are answered exactly.
CASES = (
    "b0a7276ba",
    "b11d9ee74",
    "b14566522",
    "b167f50e6",
    "b19a8dde9",
    "b05d49bda",
    "b1ed041b0",
    "b201e0ae6",
)


@pytest.mark.parametrize("case", CASES)
def test_a_sealed_case_is_answered_rightly(case, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    folder = materialise(case, tmp_path / case)
    code, said, _ = run_json(capsys, "diagnose", folder, "--out", tmp_path / "out", "--quiet")
    assert code == 0
    truth = open_answers({case})[case]
    assert said["verdict"] in truth["verdict_ok"]
    assert [cause["id"] for cause in said["causes"]] == truth["cause"]
    assert said["schema"] == "tissuereg.diagnosis/1"
    assert (tmp_path / "out" / "diagnosis.json").exists()
    code, again, _ = run_json(
        capsys, "simulate", tmp_path / "out" / "experiment.extended.toml", "--out", tmp_path / "sim"
    )
    assert code == 0
    assert not again["failed"]
