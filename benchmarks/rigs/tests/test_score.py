"""The figures of made-up answers, and what an archive keeps of them."""

import json

import pytest

from blind.scored import Scored
from rigs import page
from rigs.run import ORACLE, WITHOUT
from rigs.score import figures


def case(name, kind, hidden, named, evidence=9.0):
    """Return an answer on a case with hidden causes, in which some are named."""
    causes = [{"id": one, "group": [one], "probability": 0.9, "log_bayes_factor": evidence} for one in named]
    truth = {
        "kind": kind, "cause": hidden, "group_ok": hidden, "level": 8.0, "own_form": [True], "outside": [],
        "code": "ngsolve", "readings": ["ball"], "detectability": 8.0,
    }  # fmt: skip
    return Scored(name, truth, {"verdict": "named" if named else "consistent", "causes": causes})


def row_of(rows, figure):
    """Return the count of a figure, as ``hits of n``."""
    (row,) = [row for row in rows if row.startswith(f"| {figure} |")]
    return row.split("|")[2].strip()


def test_what_the_oracle_fit_does_not_see_is_left_out():
    seen = case("rig-01-a", "single", ["layer"], ["layer"])
    missed = case("rig-02-a", "single", ["layer"], [])
    hidden = case("rig-03-a", "single", ["fibre"], [])
    pairs = [case(f"box-0{n}-a", "pair", ["layer", "fibre"], ["layer"]) for n in (1, 2)]
    oracle = {
        one.case: {"causes": [{"log_bayes_factor": gain} for gain in gains]}
        for one, gains in (
            (seen, [30.0]),
            (missed, [6.1]),
            (hidden, [5.9]),
            (pairs[0], [9.0, 8.0]),
            (pairs[1], [9.0, 5.0]),
        )
    }
    rows = list(figures([seen, missed, hidden, *pairs], [], oracle))
    assert row_of(rows, "one cause, any d: right group") == "1 of 3"
    assert row_of(rows, "one cause, where the oracle fit gains 6 nats: right group") == "1 of 2"
    assert row_of(rows, "pairs on boxes: one right and none wrong") == "2 of 2"
    assert row_of(rows, "pairs on boxes, where the oracle fit gains 6 nats with each cause: both named") == "0 of 1"
    assert not any("oracle" in row for row in figures([seen], [], {}))


@pytest.mark.parametrize("methods", [(), (ORACLE,), (WITHOUT, ORACLE)])
def test_an_archive_gives_back_what_the_page_needs(tmp_path, monkeypatch, methods):
    monkeypatch.setattr(page, "ARCHIVE", tmp_path / "archive")
    name = "box-01-8c860"
    for folder in ("", *methods):
        kept = tmp_path / "answers" / folder / f"{name}.json"
        kept.parent.mkdir(parents=True, exist_ok=True)
        answer = case(name, "pair", ["layer"], ["layer"]).prediction | {"p_misfit": 0.5, "seconds": 1.0}
        kept.write_text(json.dumps(answer), encoding="utf-8")
    page.pack(tmp_path / "answers", "dev")
    found = page.archives()["dev"]
    for table in ("rows", *methods):
        assert found[table][name]["causes"][0]["log_bayes_factor"] == 9.0
    assert {WITHOUT, ORACLE} & {table for table in found if found[table]} == set(methods)
