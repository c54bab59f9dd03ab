"""Rivals and ablations compared with the diagnoser, in one table.

Each is compared on the cases that both have answered. The gain is the median of `blind.scored.gains` over separable
single effects with d >= 8: how much of the oracle fit's improvement on the held-out blocks the method's final model
reaches, whether or not it names anything.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np

from blind.scored import Scored, clear_singles, gains, of_kind, read_predictions, scored, singles

#: Folders of predictions below those of the diagnoser, each with one folder a method.
KINDS = ("rivals", "ablations")

OURS = "tissuereg"

_HEAD = (
    "method",
    "cases",
    "false alarms on nulls",
    "nulls consistent",
    "right group, d >= 8",
    "exact, d >= 8",
    "wrong group, all singles",
    "outside misnamed",
    "held-out gain",
    "made",
)


def read_methods(predictions: Path) -> dict[str, list[Scored]]:
    """Return the scored cases of rivals and ablations, by name."""
    folders = [path for kind in KINDS for path in sorted((predictions / kind).glob("*")) if path.is_dir()]
    found = {f"{path.parent.name[:-1]}: {path.name}": scored(read_predictions(path)) for path in folders}
    return {name: cases for name, cases in found.items() if cases}


def comparison(ours: list[Scored], methods: dict[str, list[Scored]], oracle: dict[str, dict]) -> list[str]:
    """Return the table in Markdown, line by line.

    Parameters
    ----------
    ours : list of Scored
        Predictions of the diagnoser.
    methods : dict of str to list of Scored
        Predictions of the others, by name. Methods that answered the same cases share one row of the diagnoser.
    oracle : dict
        Predictions of the oracle fit (given the true cause), by case.
    """
    groups: dict[frozenset[str], list[str]] = defaultdict(list)
    mine = {c.case for c in ours}
    for name, cases in methods.items():
        groups[frozenset(mine & {c.case for c in cases})].append(name)
    lines = ["| " + " | ".join(_HEAD) + " |", "|---" * len(_HEAD) + "|"]
    for shared, names in groups.items():
        for name, cases in [(OURS, ours), *((name, methods[name]) for name in names)]:
            lines.append(_row(name, [c for c in cases if c.case in shared], oracle))
    return lines


def made(cases: list[Scored]) -> str:
    """Return the commits, dates and times of predictions in words."""
    commits = sorted({c.prediction["commit"] for c in cases if "commit" in c.prediction})
    dates = sorted(c.prediction["date"][:10] for c in cases if "date" in c.prediction)
    seconds = [c.prediction["seconds"] for c in cases if "seconds" in c.prediction]
    parts = [f"commit {', '.join(commits)}"] if commits else []
    if dates:
        parts.append(dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}")
    if seconds:
        parts.append(f"median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s")
    failed = sum(c.prediction["verdict"] == "failed" for c in cases)
    return "; ".join([*parts, f"{failed} failed"])


def _row(name: str, cases: list[Scored], oracle: dict[str, dict]) -> str:
    nulls, clear, outside = of_kind(cases, "null"), clear_singles(cases), of_kind(cases, "outside")
    gained = gains([c for c in clear if c.case in oracle], oracle)[0]
    cells = [
        name,
        str(len(cases)),
        _share([bool(c.ids) for c in nulls]),
        _share([c.prediction["verdict"] == "consistent" for c in nulls]),
        _share([c.right for c in clear]),
        _share([c.exact for c in clear]),
        _share([c.wrong for c in singles(cases)]),
        _share([bool(c.ids) for c in outside]),
        f"{np.median(gained):.2f} ({len(gained)})" if gained else "-",
        made(cases),
    ]
    return "| " + " | ".join(cells) + " |"


def _share(flags: list[bool]) -> str:
    return f"{sum(flags)} of {len(flags)}" if flags else "-"
