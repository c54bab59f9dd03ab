"""Does the page of the paper's studies hold what its archives do?"""

import json

import pytest

from support.scripts import REPOSITORY, script
from tissuereg_paper.studies import SIMULATED


@pytest.fixture
def archives():
    paper = script("benchmarks", "paper")
    return {name: json.loads(file.read_text("utf-8")) for name, file in paper.ARCHIVES.items() if file.exists()}


def test_the_page_is_that_of_its_archives(archives):
    paper = script("benchmarks", "paper")
    kept = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    assert paper.page(archives) == kept
    archives["shipped"]["studies"]["fig8"]["rows"][0]["end_mean_mm"] += 0.1
    assert paper.page(archives) != kept


def test_every_study_was_run_with_every_model(archives):
    assert "shipped" in archives
    for archive in archives.values():
        assert tuple(archive["studies"]) == SIMULATED
        for study, content in archive["studies"].items():
            assert content["agree"][study]["agree"] in ("yes", "no")
            assert {row["study"] for row in content["rows"]} == {study}


def test_every_picture_of_the_page_is_there(archives):
    paper = script("benchmarks", "paper")
    text = paper.page(archives)
    pictures = [paper._picture(name, study) for name in archives for study in SIMULATED]
    assert all(picture.exists() and f"({picture.name})" in text for picture in pictures)
