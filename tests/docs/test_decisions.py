"""Is every decision a page with a question, a measurement and a choice? Do the pages name files that exist?"""

import re

import pytest

from support.scripts import REPOSITORY

DECISIONS = REPOSITORY / "docs" / "decisions"
PAGES = sorted(path for path in DECISIONS.glob("*.md") if path.name != "index.md")
HEADINGS = ["Question", "What was measured", "Choice"]
#: Folders from which pages name files.
ROOTS = ("", "python/tissuereg", "crates/fem/src")


def faults(text: str) -> list[str]:
    """What a page lacks, in words."""
    title, *parts = re.split(r"^## ", text, flags=re.MULTILINE)
    headings = [part.partition("\n")[0] for part in parts]
    wrong = [] if re.match(r"# [A-Z][^\n]*\?\n\nRecorded \d{4}-\d\d-\d\d[^\n]*\.\n", title) else ["title and date"]
    wrong += [] if headings == HEADINGS else ["headings"]
    wrong += [f"nothing under {part.partition(chr(10))[0]}" for part in parts if not part.partition("\n")[2].strip()]
    return wrong


def files_named(text: str) -> list[str]:
    """Paths of source files that a page names."""
    return re.findall(r"`([\w.-]+/[\w./-]*(?:/|\.(?:py|rs|md|toml)))`", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_decision_has_its_three_parts(page):
    assert faults(page.read_text(encoding="utf-8")) == []


def test_a_decision_without_its_parts_is_noticed():
    good = PAGES[0].read_text(encoding="utf-8")
    assert faults(good.replace("## Choice", "## Answer")) == ["headings"]
    assert faults(good.replace("?\n", "\n", 1)) == ["title and date"]
    assert faults(good.split("## Choice")[0] + "## Choice\n") == ["nothing under Choice"]


def test_the_index_lists_every_decision_once_under_its_title():
    index = (DECISIONS / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\* \[([^\]]+)\]\(([\w-]+)\.md\)$", index, flags=re.MULTILINE)
    titles = {path.stem: path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for path in PAGES}
    assert sorted(listed) == sorted((title, name) for name, title in titles.items())


@pytest.mark.parametrize("page", [REPOSITORY / "ARCHITECTURE.md", *PAGES], ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page):
    for name in files_named(page.read_text(encoding="utf-8")):
        assert any((REPOSITORY / root / name).exists() for root in ROOTS), name


def test_the_architecture_is_one_page():
    assert len((REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8").splitlines()) <= 100
