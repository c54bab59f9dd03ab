"""Are the tables of the blind bench those that its archives give?"""

import tarfile
from pathlib import Path

import pytest

from blind import score

ROOT = Path(__file__).resolve().parents[2]


def tables(text):
    """Return the rows of a page's tables."""
    return [line for line in text.splitlines() if line.startswith("|")]


@pytest.mark.parametrize(
    ("page", "archive", "tier"),
    [
        ("blind", "blind", "full"),
        ("blind-fine", "blind-fine", "fine"),
        ("blind-sample", "blind-sample", "sample"),
    ],
)
def test_tables_are_those_of_the_archived_verdicts(page, archive, tier, tmp_path, monkeypatch):
    with tarfile.open(ROOT / "benchmarks" / "results" / f"{archive}.tar.xz") as kept:
        kept.extractall(tmp_path, filter="data")
    made = tmp_path / "page.md"
    monkeypatch.setattr("sys.argv", ["blind.score", str(tmp_path / tier), "--out", str(made)])
    score.main()
    written = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert tables(made.read_text(encoding="utf-8"))
    assert set(tables(made.read_text(encoding="utf-8"))) <= set(tables(written))
