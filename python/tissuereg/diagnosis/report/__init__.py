"""The HTML page of a diagnosis: one self-contained file with text, charts and a three-dimensional view."""

from pathlib import Path


def viewer_text() -> str:
    """Return the JavaScript text of the page's three-dimensional view."""
    return Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")
