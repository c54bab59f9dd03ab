"""Markers that are lost to a value of the tracker, and exchanged ones -> archive-lost/, RESULTS-lost.md.

    python -m misuse.lost [--events N]
    python -m misuse.lost --page

On every body, in good events of 8 to 30 markers, one marker (in every other event one in five) gets a value that
trackers write for a marker which they do not see, and one good marker is held out; then two measured places are
exchanged instead.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import tissuereg as tr
from common import commit, read_archive, write_archive
from misuse.events import BODIES, misusable
from tissuereg._base.machine import machine

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive-lost", HERE / "RESULTS-lost.md", ("rows/#", "swaps/#")

VALUES = {
    "nothing lost": None,
    "0, 0, 0": (0.0, 0.0, 0.0),
    "-9999.99": (-9999.99,) * 3,
    "bad float": (-3.697314e28,) * 3,
    "one constant place": (-212.417, 80.293, -931.88),
}


def lost(body: str, number: int, value: "tuple[float, ...] | None") -> tuple[bool, bool, float]:
    """Return whether the answer is trusted, whether the held-out marker is outside its region, and how far off, mm."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 4, BODIES.index(body), number])
    n_lost = 1 if number % 4 == 1 else max(1, len(event.measured) // 5)
    held_out, *rows = rng.permutation(len(event.measured))[: 1 + n_lost]
    measured = event.measured.copy()
    truth = measured[held_out].copy()
    measured[held_out] = np.nan
    if value is not None:
        measured[rows] = value
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    target = result.unseen[event.markers().names[held_out]]
    off = float(np.linalg.norm(target.mean - truth))
    return result.trust.ok, not target.region(0.999).contains(truth), off


def swapped(body: str, number: int) -> tuple[bool, bool]:
    """Return whether two exchanged markers are named, and whether they are used again where they were put back."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 5, BODIES.index(body), number])
    pair = rng.permutation(len(event.measured))[:2]
    measured = event.measured.copy()
    measured[pair] = measured[pair[::-1]]
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    named = sum(reason.startswith("swapped: ") for reason in result.trust.reasons) == 1
    right = np.allclose(result.all_markers.measured, event.measured)
    return named, right and not {event.markers().names[i] for i in pair} - set(result.markers.used)


def page(content: dict) -> str:
    """Return the page of an archive."""
    lines = [
        "# Markers that are no measurements",
        "",
        f"`{content['command']}`, load unknown, on five bodies. *Outside*: trusted answers in which a held-out marker "
        "lies outside the region that holds it with 99.9 %.",
        "",
        "| measured place | events | trusted | outside | farthest off in those (mm) |",
        "|---|---|---|---|---|",
    ]
    for name in VALUES:
        rows = [row for row in content["rows"] if row["value"] == name]
        bad = [row["off_mm"] for row in rows if row["trusted"] and row["outside"]]
        trusted = sum(row["trusted"] for row in rows)
        lines.append(f"| {name} | {len(rows)} | {trusted} | {len(bad)} | {f'{max(bad):.1f}' if bad else ''} |")
    swaps = content["swaps"]
    named, back = (sum(row[key] for row in swaps) for key in ("named", "back"))
    lines += ["", f"Two exchanged: {len(swaps)} events, named once in {named}, put back and used in {back}."]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run and write; `--page` writes the page alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=2, help="events of each body")
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if not options.page:
        asked = [(body, number) for body in BODIES for number in range(1, 2 * options.events, 2)]
        rows, swaps = [], []
        with threadpool_limits(limits=1), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            for body, number in asked:
                for name, value in VALUES.items():
                    trusted, outside, off = lost(body, number, value)
                    found = {"trusted": trusted, "outside": outside, "off_mm": off}
                    rows.append({"value": name, "body": body, "event": number, **found})
                named, back = swapped(body, number)
                swaps.append({"body": body, "event": number, "named": named, "back": back})
        content = {"command": f"python -m misuse.lost --events {options.events}", "machine": machine(), **commit()}
        write_archive(ARCHIVE, {**content, "rows": rows, "swaps": swaps}, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
