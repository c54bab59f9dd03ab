"""Counts and places as words of a sentence."""

from tissuereg._base.arrays import FloatArray


def several(count: int, one: str, more: str | None = None) -> str:
    """Return a count with its noun, `one` in the singular and `more` (by default `one` with an s) in the plural.

    >>> several(1, "hole"), several(3, "hole"), several(2000, "vertex", "vertices")
    ('1 hole', '3 holes', '2,000 vertices')
    """
    return f"{count:,} {one if count == 1 else more or one + 's'}"


def were(count: int) -> str:
    """Return "was" for a count of 1, or else "were"."""
    return "was" if count == 1 else "were"


def place(point: FloatArray) -> str:
    """Return a point (3,) in mm as text for a sentence, such as "(3, 3.5, 0) mm"."""
    return "(" + ", ".join(f"{round(float(value), 2) + 0.0:g}" for value in point) + ") mm"
