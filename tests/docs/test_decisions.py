"""Is every decision a section with a question, a measurement and a choice? Do the pages name files that exist?"""

import re

import pytest

from support.anchors import anchors, slug
from support.scripts import REPOSITORY

DECISIONS = REPOSITORY / "docs" / "decisions"
PAGES = sorted(path for path in DECISIONS.glob("*.md") if path.name != "index.md")
#: Folders from which pages name files.
ROOTS = ("", "python/tissuereg", "crates/fem/src")
PARTS = ("Measured", "Chosen", "Limits")
OPENING = re.compile(r"\n\*([A-Z][^\n*]+\?)\* \d{4}-\d\d-\d\d\n\n")


def sections(text):
    """Return heading and text of every decision of a page."""
    return [tuple(part.split("\n", 1)) for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]]


def faults(text):
    """What a decision lacks, in words."""
    pieces = re.split(r"^\*\*(\w+)\.\*\*", text, flags=re.MULTILINE)
    names, bodies = pieces[1::2], pieces[2::2]
    wrong = [] if OPENING.match(text) else ["question and date"]
    wrong += [] if names in ([*PARTS], [*PARTS[:2]]) else ["parts"]
    return wrong + [f"nothing under {name}" for name, body in zip(names, bodies, strict=True) if not body.strip()]


def files_named(text):
    """Paths of source files that a page names."""
    return re.findall(r"`([\w.-]+/[\w./-]*(?:/|\.(?:py|rs|md|toml)))`", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_decision_has_its_question_and_its_parts(page):
    found = sections(page.read_text(encoding="utf-8"))
    assert found
    assert {heading: faults(text) for heading, text in found if faults(text)} == {}


def test_a_decision_without_its_parts_is_noticed():
    _, good = sections((DECISIONS / "solver.md").read_text(encoding="utf-8"))[0]
    assert faults(good) == []
    assert faults(good.replace("**Chosen.**", "**Answer.**")) == ["parts"]
    assert faults(good.replace("?*", "*", 1)) == ["question and date"]
    assert faults(good.split("**Chosen.**")[0] + "**Chosen.**\n") == ["nothing under Chosen"]


def test_the_index_lists_every_decision_once_under_its_question():
    index = (DECISIONS / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\* \[([^\]]+)\]\(([\w-]+\.md)#([\w-]+)\)$", index, flags=re.MULTILINE)
    found = [
        (OPENING.match(text)[1], page.name, slug(heading))
        for page in PAGES
        for heading, text in sections(page.read_text(encoding="utf-8"))
    ]
    assert sorted(listed) == sorted(found)
    assert all(anchor in anchors((DECISIONS / page).read_text(encoding="utf-8")) for _, page, anchor in listed)


@pytest.mark.parametrize("page", [REPOSITORY / "ARCHITECTURE.md", *PAGES], ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page):
    for name in files_named(page.read_text(encoding="utf-8")):
        assert any((REPOSITORY / root / name).exists() for root in ROOTS), name


def test_the_architecture_is_one_page():
    assert len((REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8").splitlines()) <= 100
