"""The page of the bench, made from its answers."""

from collections import Counter
from math import sqrt

from misuse.misuses import MISUSES
from misuse.run import N_MISUSED

HEAD = """# Misread inputs: what geometry finds before anything is solved

Made by `python benchmarks/misuse.py` from `benchmarks/results/misuse.json`; edit neither.
`tissuereg.readings.suspect` was developed on even-numbered events; all figures here are of odd-numbered ones, which
differ in field, markers, noise and mistake.

{n_misuses} mistakes on {n_bodies} bodies ({bodies}), {n_each} events each: simulated pulls, pushes and own weight
with a largest motion of 3 to 25 mm, 8 to 30 markers up to 6 mm off the skin, noise of 0.05 to 0.5 mm. *Refused*:
making mesh, markers or observation raises a typed error. *Found*: refused, or any suspicion. *Named*: a suspicion of
a kind that states the reason (`MISUSES` in `tests/misuse/misuses.py`). *Nothing tells*: mesh and markers are as
plausible after the mistake as before: all places stay within 2 mm of their distance from the surface with the same
motion (a round body with two axes negated); exchanged markers lie within 3 mm and their noise of each other; another
organ's markers lie all within 6 mm of this one's surface. The last two columns leave these events out.
"""

GOOD = """
## Good events

{n_good} events: 3 to 60 markers (random, spread, in one region, near the load), 0 to 6 mm off the skin, noise of 0.05
to 1 mm, numbers rounded to 0.1, 0.01, 0.001 mm or not at all; in a fifth of them markers or single coordinates are
missing; a tenth is of bodies without held nodes that also move rigidly by up to 60 mm and 40 degrees, which is legal
there.

False alarms: **{n_alarms} of {n_good}** ({share}; 95 % interval {low} to {high}){kinds}.

With one marker 5 mm off, which is for the mechanics to find, {n_off} of {n_off_all} such events were called
misread{off_kinds}.
"""


def interval(count: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    z, p = 1.959964, count / n
    middle, half = p + z * z / (2 * n), z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (middle - half) / (1 + z * z / n)), (middle + half) / (1 + z * z / n)


def page(answers: dict) -> str:
    """Return the page of an archive's odd-numbered events."""
    rows = [row for row in answers["misuses"] if row["event"] % 2]
    bodies = list(dict.fromkeys(row["body"] for row in rows))
    head = HEAD.format(n_misuses=len(MISUSES), n_bodies=len(bodies), bodies=", ".join(bodies), n_each=N_MISUSED // 2)
    table = ["| misuse | events | refused | found | named | nothing tells | found of the others | named of them |"]
    table.append("| --- | --- | --- | --- | --- | --- | --- | --- |")
    table += [_row(misuse.title, [row for row in rows if row["misuse"] == misuse.title]) for misuse in MISUSES]
    table.append(_row("**all**", rows))
    missed = Counter((row["misuse"], _said(row)) for row in rows if not row["named"] and not row["alike"])
    ends = [f"* {title}: {said}, {count}" for (title, said), count in missed.items()]
    unnamed = "\n## Not named, though something tells\n\n" + ("\n".join(ends) if ends else "None.") + "\n"
    return head + "\n" + "\n".join(table) + "\n" + unnamed + _good(answers)


def _row(title: str, rows: list[dict]) -> str:
    told = [row for row in rows if not row["alike"]]
    counts = [
        len(rows),
        sum(row["refused"] is not None for row in rows),
        sum(row["found"] for row in rows),
        sum(row["named"] for row in rows),
        len(rows) - len(told),
    ]
    shares = [_share(sum(row[what] for row in told), len(told)) for what in ("found", "named")]
    return "| " + " | ".join([title, *map(str, counts), *shares]) + " |"


def _good(answers: dict) -> str:
    good = [row for row in answers["good"] if row["event"] % 2]
    alarms = [row for row in good if row["found"]]
    off = [row for row in answers["one_marker_off"] if row["event"] % 2]
    called = [row for row in off if row["found"]]
    low, high = interval(len(alarms), len(good))
    return GOOD.format(
        n_good=len(good),
        n_alarms=len(alarms),
        share=_share(len(alarms), len(good)),
        low=f"{100 * low:.2f}",
        high=f"{100 * high:.2f} %",
        kinds=_kinds(alarms),
        n_off=len(called),
        n_off_all=len(off),
        off_kinds=_kinds(called),
    )


def _kinds(rows: list[dict]) -> str:
    counts = Counter(_said(row) for row in rows)
    return ": " + ", ".join(f"{said} {count}" for said, count in counts.most_common()) if rows else ""


def _said(row: dict) -> str:
    return ", ".join(row["kinds"]) or (row["refused"] or "nothing said")


def _share(count: int, n: int) -> str:
    return f"{100 * count / n:.1f} %" if n else "-"
