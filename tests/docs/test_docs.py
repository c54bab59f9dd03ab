"""Are the documents true? Docstring examples and links; the blocks of pages are in test_pages.py."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

import tissuereg
from support.anchors import anchors

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = Path(tissuereg.__file__).parent
MODULES = sorted(
    ".".join(("tissuereg", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if path.name != "__main__.py"
)


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples_hold(name):
    failures, _ = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert failures == 0


@pytest.mark.parametrize("document", sorted(REPOSITORY.glob("*.md")) + sorted((REPOSITORY / "docs").rglob("*.md")))
def test_links_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]+`", "", text)):
        name, _, anchor = target.partition("#")
        if "://" in target or target.startswith("mailto:"):
            continue
        page = document.parent / name if name else document
        assert page.exists(), f"{document.name}: {target}"
        if anchor and page.suffix == ".md":
            assert anchor in anchors(page.read_text(encoding="utf-8")), f"{document.name}: {target}"


def test_decisions_that_sources_name_exist():
    sources = [
        path
        for folder in ("python", "crates", "training", "benchmarks", "paper", "tests", "tools", "examples")
        for ending in ("py", "rs", "toml", "md")
        for path in (REPOSITORY / folder).rglob(f"*.{ending}")
    ]
    named = {
        match.groups()
        for path in sources
        for match in re.finditer(r"docs/decisions/([\w-]+\.md)(?:#([\w-]+))?", path.read_text(encoding="utf-8"))
    }
    assert named
    for name, anchor in named:
        page = REPOSITORY / "docs" / "decisions" / name
        assert page.is_file(), name
        assert anchor is None or anchor in anchors(page.read_text(encoding="utf-8")), f"{name}#{anchor}"
