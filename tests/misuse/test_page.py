"""The page of the bench is what the command writes from its archive."""

import json
from pathlib import Path

import pytest

from misuse.misuses import MISUSES
from misuse.page import interval, page

REPOSITORY = Path(__file__).resolve().parents[2]


def test_the_page_is_that_of_the_archive():
    answers = json.loads((REPOSITORY / "benchmarks" / "results" / "misuse.json").read_text(encoding="utf-8"))
    written = (REPOSITORY / "docs" / "misuse.md").read_text(encoding="utf-8")
    assert written == page(answers)
    answers["good"][0]["found"] = not answers["good"][0]["found"]
    assert written != page(answers)


def test_there_are_forty_mistakes_with_a_title_each():
    assert len({misuse.title for misuse in MISUSES}) == 40


def test_wilsons_interval_is_that_of_the_textbook():
    low, high = interval(1, 500)
    assert (low, high) == pytest.approx((0.000353, 0.011234), abs=1e-5)
