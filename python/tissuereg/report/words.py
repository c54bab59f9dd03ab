"""Sentences that picture, page and command line share."""

from collections.abc import Sequence


def verdict(ok: bool) -> str:
    """Return whether a registration can be trusted, plainly.

    Examples
    --------
    >>> verdict(False)
    'Do not trust this registration.'
    """
    return "Nothing speaks against this registration." if ok else "Do not trust this registration."


def silent(names: Sequence[str]) -> str:
    """Return what it means that no marker tells of targets.

    Examples
    --------
    >>> silent(["lesion"])
    'No marker tells of lesion: its region holds only if nothing else pushes or pulls nearby.'
    """
    whose = "its region holds" if len(names) == 1 else "their regions hold"
    return f"No marker tells of {', '.join(names)}: {whose} only if nothing else pushes or pulls nearby."
