"""The tables of `README.md`, each between two marks that name its archive."""

from pathlib import Path

README = Path(__file__).resolve().parent / "README.md"


def marks(archive: str) -> tuple[str, str]:
    """Return the lines before and after the table of an archive."""
    return f"<!-- {archive}: begin -->\n", f"<!-- {archive}: end -->"


def table(archive: str) -> str:
    """Return the table of an archive."""
    begin, end = marks(archive)
    return README.read_text(encoding="utf-8").split(begin)[1].split(end)[0]


def write_table(archive: str, table: str) -> None:
    """Replace the table of an archive."""
    begin, end = marks(archive)
    before, rest = README.read_text(encoding="utf-8").split(begin)
    README.write_text(before + begin + table + end + rest.split(end)[1], encoding="utf-8")
