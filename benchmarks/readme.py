"""The tables of `README.md` and of other pages, each between two marks that name its archive."""

from pathlib import Path

README = Path(__file__).resolve().parent / "README.md"


def marks(archive: str) -> tuple[str, str]:
    """Return the lines before and after the table of an archive."""
    return f"<!-- {archive}: begin -->\n", f"<!-- {archive}: end -->"


def table(archive: str, page: Path = README) -> str:
    """Return the table of an archive."""
    begin, end = marks(archive)
    return page.read_text(encoding="utf-8").split(begin)[1].split(end)[0]


def write_table(archive: str, table: str, page: Path = README) -> None:
    """Replace the table of an archive."""
    begin, end = marks(archive)
    before, rest = page.read_text(encoding="utf-8").split(begin)
    page.write_text(before + begin + table + end + rest.split(end)[1], encoding="utf-8")
