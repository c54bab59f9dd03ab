"""Sentences that the picture, the HTML page and the command line share."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def verdict(ok: bool) -> str:
    """Return a sentence on whether a registration can be trusted.

    >>> verdict(False)
    'Do not trust this registration.'
    """
    return "Nothing speaks against this registration." if ok else "Do not trust this registration."


def counted(number: int, thing: str) -> str:
    """Return a number and a noun as text, the noun in the plural unless the number is 1.

    >>> counted(1, "marker"), counted(3, "marker")
    ('1 marker', '3 markers')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"


def at_time(time_s: float) -> str:
    """Return a time in s, to 0.1 ms, also where a clock counts from 1970.

    >>> at_time(0.5), at_time(1.7e9 + 1 / 60)
    ('0.5', '1700000000.0167')
    """
    return f"{round(time_s, 4):.14g}"


def markers_used(used: Iterable[str], inner: Iterable[str]) -> str:
    """Return how many markers were used, and how many of these are inside the body, given the names of either.

    >>> markers_used(["M1", "M2", "S1"], ["S1", "S2"])
    '3 markers (1 inside the body)'
    """
    names = list(used)
    deep = len(set(names) & set(inner))
    return counted(len(names), "marker") + (f" ({deep} inside the body)" if deep else "")


def start_word(simulated: bool) -> str:
    """Return the words for the state that distances are compared with: the simulation, or the body before."""
    return "in the simulation" if simulated else "before"


def silent(names: Sequence[str]) -> str:
    """Return the warning for targets that the markers do not constrain (flag "no marker tells").

    >>> silent(["lesion"])
    'No marker tells of lesion: its region holds only if nothing else pushes or pulls nearby.'
    """
    whose = "its region holds" if len(names) == 1 else "their regions hold"
    return f"No marker tells of {', '.join(names)}: {whose} only if nothing else pushes or pulls nearby."


def fallback_lines(places: Mapping[str, Iterable[float]]) -> list[str]:
    """Return sentences with target places (3,), mm, by linear elasticity, for an answer that is not to be trusted.

    >>> fallback_lines({"lesion": (1.0, 2.5, -3.0)})
    ['By linear elasticity alone, without a region: lesion at (1.00, 2.50, -3.00) mm.']
    """
    return [
        f"By linear elasticity alone, without a region: {name} at ({', '.join(f'{x:.2f}' for x in place)}) mm."
        for name, place in places.items()
    ]


def target_line(name: str, target: dict[str, Any], when: str = "") -> str:
    """Return a line with a target's place and half-axes, mm, out of its JSON entry; `when` follows its name."""
    place = ", ".join(f"{x:.2f}" for x in target["mean_mm"])
    axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
    return f"target {name}{when}: at ({place}) mm, 90 % region with half-axes {axes} mm"
