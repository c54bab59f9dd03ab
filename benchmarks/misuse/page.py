"""The page of the bench, written from its archived answers."""

from collections import Counter
from math import sqrt

from misuse.misuses import MISUSES
from misuse.run import N_MISUSED

HEAD = """# Misread inputs: what the checks of geometry find before anything is solved

Written by `make -C benchmarks/misuse` from `archive/`; edit neither.
`tissuereg.registration.readings.suspect` was developed on even-numbered events; all figures here are for
odd-numbered ones, which differ in displacement field, markers, noise and mistake.

{n_misuses} kinds of mistake on {n_bodies} bodies ({bodies}), {n_each} events each: simulated pulls, pushes and own
weight with a largest motion of 3 to 25 mm, 8 to 30 markers up to 6 mm off the skin, noise of 0.05 to 0.5 mm.

* *Refused*: constructing the mesh, the markers or the observation raises a typed error.
* *Found*: refused, or any suspicion is raised.
* *Named*: a suspicion of a kind that states the actual mistake (`MISUSES` in `misuses.py`).
* *Undetectable*: mesh and markers are as plausible with the mistake as without it. All positions keep their distance
  from the surface within 2 mm, with the same motion (a round body with two axes negated); or exchanged markers lie
  within 3 mm and their noise of each other; or another organ's markers all lie within 6 mm of this one's surface.
  The last two columns leave these events out.
"""

GOOD = """
## Good events

{n_good} events: 3 to 60 markers (random, spread, in one region, near the load), 0 to 6 mm off the skin, noise of 0.05
to 1 mm, numbers rounded to 0.1, 0.01, 0.001 mm or not at all; in a fifth of them markers or single coordinates are
missing; a tenth of them are bodies without held nodes that also move rigidly by up to 60 mm and 40 degrees, which is
valid input there.

False alarms: **{n_alarms} of {n_good}** ({share}; 95 % interval {low} to {high}){kinds}.

One marker displaced by 5 mm is for the mechanics to find, not for these checks: {n_off} of {n_off_all} such events
raised a suspicion{off_kinds}.
"""

REGISTERED = """
## Through `register`

Events in which these checks find nothing are registered with the load unknown. A marker is *named* if it is dropped
as wrong or appears in a reason; the answer is *trusted* if `trust.ok`.

Good events: {n_good} registered, **{n_alarms} not trusted** ({share}; 95 % interval {low} to {high}){kinds}. A wrong
marker is named in {n_named} of them, mostly without a loss of trust, because it lies inside the region predicted from
the other markers.

One marker displaced by 5 mm: {n_off} registered; the marker is named in {n_off_named}, the answer is not trusted in
{n_off_untrusted}.

"""


def interval(count: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    z, p = 1.959964, count / n
    middle, half = p + z * z / (2 * n), z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (middle - half) / (1 + z * z / n)), (middle + half) / (1 + z * z / n)


def page(answers: dict) -> str:
    """Return the page for the odd-numbered events of an archive."""
    rows = [row for row in answers["misuses"] if row["event"] % 2]
    bodies = list(dict.fromkeys(row["body"] for row in rows))
    head = HEAD.format(n_misuses=len(MISUSES), n_bodies=len(bodies), bodies=", ".join(bodies), n_each=N_MISUSED // 2)
    table = ["| misuse | events | refused | found | named | undetectable | found, others | named, others |"]
    table.append("| --- | --- | --- | --- | --- | --- | --- | --- |")
    table += [_row(misuse.title, [row for row in rows if row["misuse"] == misuse.title]) for misuse in MISUSES]
    table.append(_row("**all**", rows))
    missed = Counter((row["misuse"], _response(row)) for row in rows if not row["named"] and not row["alike"])
    ends = [f"* {title}: {output}, {count}" for (title, output), count in missed.items()]
    unnamed = "\n## Detectable, but not named\n\n" + ("\n".join(ends) if ends else "None.") + "\n"
    return head + "\n" + "\n".join(table) + "\n" + unnamed + _good(answers) + _registered(answers)


def _row(title: str, rows: list[dict]) -> str:
    detectable = [row for row in rows if not row["alike"]]
    counts = [
        len(rows),
        sum(row["refused"] is not None for row in rows),
        sum(row["found"] for row in rows),
        sum(row["named"] for row in rows),
        len(rows) - len(detectable),
    ]
    shares = [_share(sum(row[what] for row in detectable), len(detectable)) for what in ("found", "named")]
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


def _registered(answers: dict) -> str:
    """Return the section on `register` for the odd-numbered events in which the checks of geometry find nothing."""
    good, off, misread = (
        [row for row in answers[which] if row["event"] % 2 and not row["found"]]
        for which in ("good", "one_marker_off", "misuses")
    )
    alarms = _untrusted(good)
    low, high = interval(len(alarms), len(good))
    counts = Counter(_reason(row) for row in alarms)
    text = REGISTERED.format(
        n_good=len(good),
        n_alarms=len(alarms),
        share=_share(len(alarms), len(good)),
        low=f"{100 * low:.2f}",
        high=f"{100 * high:.2f} %",
        kinds=": " + ", ".join(f"{output} {count}" for output, count in counts.most_common()) if alarms else "",
        n_named=sum(bool(row["register"]["wrong"]) for row in good),
        n_off=len(off),
        n_off_named=sum(_names_its_marker(row) for row in off),
        n_off_untrusted=len(_untrusted(off)),
    )
    table = ["| misuse not found | registered | not trusted | undetectable | not trusted, others |"]
    table.append("| --- | --- | --- | --- | --- |")
    for title in [*dict.fromkeys(row["misuse"] for row in misread), None]:
        rows = [row for row in misread if title in (None, row["misuse"])]
        others = [row for row in rows if not row["alike"]]
        counts_of = [len(rows), len(_untrusted(rows)), len(rows) - len(others), len(_untrusted(others))]
        table.append("| " + " | ".join([title or "**all**", *map(str, counts_of)]) + " |")
    return text + "\n".join(table) + "\n"


def _untrusted(rows: list[dict]) -> list[dict]:
    return [row for row in rows if not row["register"]["trusted"]]


def _reason(row: dict) -> str:
    """Return the kinds of the reasons why an answer is not trusted."""
    kinds = dict.fromkeys(reason.split(":")[0] for reason in row["register"]["reasons"])
    return " and ".join(kinds)


def _names_its_marker(row: dict) -> bool:
    """Return whether the displaced marker is dropped as wrong or appears in a reason."""
    reasons = row["register"]["reasons"]
    return row["marker"] in row["register"]["wrong"] or any(f" {row['marker']} " in reason for reason in reasons)


def _kinds(rows: list[dict]) -> str:
    counts = Counter(_response(row) for row in rows)
    return ": " + ", ".join(f"{output} {count}" for output, count in counts.most_common()) if rows else ""


def _response(row: dict) -> str:
    return ", ".join(row["kinds"]) or (row["refused"] or "no suspicion")


def _share(count: int, n: int) -> str:
    return f"{100 * count / n:.1f} %" if n else "-"
