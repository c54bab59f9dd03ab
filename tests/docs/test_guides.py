"""Do the guides work? They are followed to the letter in a copy of the sources, and their own tests are run there."""

import os
import shutil

import pytest

from support.guides import GUIDES, build_core, cargo, copy_of_crates, copy_of_package, follow, lint, run, steps
from support.scripts import REPOSITORY


@pytest.fixture
def root(tmp_path):
    return copy_of_package(tmp_path)


@pytest.mark.parametrize(("guide", "passed"), [("file-format", 6), ("cause", 4)])
def test_what_a_guide_adds_works(guide, passed, root):
    commands = follow(guide, root)
    lint(guide, root)
    assert len(commands) == 1
    assert f"{passed} passed" in run(root, commands[0])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cargo") is None or os.name == "nt", reason="builds the core: needs cargo")
def test_a_law_is_added_as_the_guide_says():
    # Always the same place: cargo knows a crate by its folder.
    root = REPOSITORY / "target" / "guides" / "law"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    try:
        copy_of_crates(copy_of_package(root))
        in_rust, in_python = follow("law", root)
        lint("law", root)
        cargo(root, "fmt", "--all", "--check")
        assert "3 passed" in cargo(root, *in_rust[1:])
        build_core(root)
        assert "2 passed" in run(root, in_python)
    finally:
        # While the copy is there cargo takes what was built of it, with the guide's law, for the repository's own.
        shutil.rmtree(root)


def test_a_step_whose_line_is_gone_is_noticed(root):
    table = root / "python" / "tissuereg" / "io" / "point_files.py"
    table.write_text(table.read_text(encoding="utf-8").replace('".fcsv": read_fcsv,', '".fcsv": read_fcsv'))
    with pytest.raises(AssertionError, match=r"must stand in .* once, found 0 times"):
        follow("file-format", root)


@pytest.mark.parametrize("guide", sorted(path.stem for path in GUIDES.glob("*.md") if path.stem != "index"))
def test_every_step_of_a_guide_finds_its_line(guide, root):
    copy_of_crates(root)
    assert follow(guide, root)
    found = steps(guide)
    assert found[-1].verb == "Run"
    assert any(step.verb == "New file" for step in found)
