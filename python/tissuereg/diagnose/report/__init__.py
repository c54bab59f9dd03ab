"""The page of a diagnosis: what a simulation gets wrong, for people to look at."""

from pathlib import Path


def viewer_text() -> str:
    """Return the script of the turnable view."""
    return Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")
