"""Do the guides work? They are followed to the letter in a copy of the sources, and their own tests are run there."""

import pytest

from support.guides import GUIDES, copy_of_package, follow, run, steps


@pytest.fixture
def root(tmp_path):
    return copy_of_package(tmp_path)


def test_a_file_format_is_added_as_the_guide_says(root):
    commands = follow("file-format", root)
    assert len(commands) == 1
    assert "6 passed" in run(root, commands[0])


def test_a_step_whose_line_is_gone_is_noticed(root):
    table = root / "python" / "tissuereg" / "io" / "point_files.py"
    table.write_text(table.read_text(encoding="utf-8").replace('".fcsv": read_fcsv,', '".fcsv": read_fcsv'))
    with pytest.raises(AssertionError, match=r"must stand in .* once, found 0 times"):
        follow("file-format", root)


@pytest.mark.parametrize("guide", sorted(path.stem for path in GUIDES.glob("*.md") if path.stem != "index"))
def test_every_block_of_a_guide_is_a_step(guide):
    found = steps(guide)
    assert found[-1].verb == "Run"
    assert any(step.verb == "New file" for step in found)
