"""Two sealed cases through the command, the answers opened after it has spoken: a marker that slipped, and nothing."""

import gzip
import json

import pytest

from blind.materialise import DATA, materialise
from support.files import run_json

SLIPPED, NOTHING = "b14566522", "b05d49bda"


def answer_of(case):
    with gzip.open(DATA / "answers.json.gz", "rt", encoding="utf-8") as sealed:
        return json.load(sealed)["answers"][case]


@pytest.mark.parametrize("case", [SLIPPED, NOTHING])
def test_a_sealed_case_is_answered_rightly(case, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    folder = materialise(case, tmp_path / case)
    code, said, _ = run_json(capsys, "diagnose", folder, "--out", tmp_path / "out", "--quiet")
    assert code == 0
    truth = answer_of(case)
    assert said["verdict"] in truth["verdict_ok"]
    assert [cause["id"] for cause in said["causes"]] == truth["cause"]
    assert said["schema"] == "tissuereg.diagnosis/1"
    assert (tmp_path / "out" / "diagnosis.json").exists()
    code, again, _ = run_json(
        capsys, "simulate", tmp_path / "out" / "experiment.extended.toml", "--out", tmp_path / "sim"
    )
    assert code == 0
    assert not again["failed"]
