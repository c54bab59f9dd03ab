"""The table of times matches its archive, and a measurement is a first call and the next."""

import json
import subprocess
import sys

import pytest

from common import BENCHES, write_archive
from loadfree import table, times

WORK = dict.fromkeys(times.WORK, 3)


def call(name, wall, body=0.2):
    stages = {"sample": 0.6 * wall, "attach": 0.001 * wall, "total": wall}
    return {"call": name, "wall_s": wall, "cpu_s": 2 * wall, "body_mm": body, "moved_mm": 1.0} | {
        "work": WORK,
        "stages_s": stages,
    }


def answer(*walls):
    spent = {"wall_s": 0.5, "cpu_s": 0.5}
    runs = [{"import": spent, "small": spent, "calls": [call("first", w), call("next", w / 10)]} for w in walls]
    return {
        "command": "python -m loadfree.timing",
        "date": "2026-01-01",
        "commit": "abc",
        "changed_files": False,
        "machine": {"processor": "none", "cores": 2},
        "versions": {"python": "3"},
        "threads": 2,
        "runs": {"dome": runs},
    }


def test_rows_are_medians_with_their_goals_and_cases_that_were_not_run_are_left_out():
    text = times.tables(answer(1.0, 4.0, 2.0))
    rows = [line for line in text.splitlines() if line.startswith(("| dome", "| the next", "| half"))]
    assert len(rows) == 2
    assert "| 3 | 2.00 | 1 | 1.00 to 4.00 | 4.00 | 0.20 (1.00) |" in rows[0]
    assert "| 3 | 0.20 | 0.35 | 0.10 to 0.40 | 0.40 |" in rows[1]
    assert "passes 3, factorisations 3" in rows[0]
    assert rows[0].endswith("| sample 1.20 |")  # what takes moments is left out


def test_the_page_has_times_where_there_is_an_archive(tmp_path, monkeypatch):
    monkeypatch.setattr(times, "ARCHIVE", tmp_path / "times")
    assert "## Times" not in table.page()
    write_archive(times.ARCHIVE, answer(1.0), times.TABLES)
    assert table.page().endswith(times.tables(answer(1.0)))


@pytest.mark.slow
def test_a_process_times_the_first_call_and_the_next():
    words = [sys.executable, "-m", "loadfree.timing_work", "dome", "0"]
    done = subprocess.run(words, cwd=BENCHES, capture_output=True, text=True, check=True)
    first, then = json.loads(done.stdout)["calls"]
    assert (first["call"], then["call"]) == ("first", "next")
    assert first["n_nodes"] == 4227
    for row in (first, then):
        assert row["wall_s"] > 0.5 * row["stages_s"]["total"] > 0.0
        assert row["body_mm"] < 0.5 * row["moved_mm"]
        assert set(times.WORK) <= set(row["work"])
