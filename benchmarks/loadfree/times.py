"""The table of `loadfree.timing`: wall times of whole calls."""

import numpy as np

from common import read_archive
from loadfree.archive import RESULTS

ARCHIVE, TABLES = RESULTS / "time", ("runs/<case>/#",)
SCHEMA = "tissuereg.loadfree-time/1"

#: Case and call, its description, and the goal in wall seconds.
ROWS = (
    ("dome", "first", "dome, 15 markers, first call on the mesh", 1.0),
    ("dome", "next", "the next call, other values at the same markers", 0.35),
    ("large", "first", "half ellipsoid of 20,000 nodes, 15 markers, first call", 8.0),
    ("points", "first", "dome, 500 points of its surface without labels, first call", 5.0),
)

INTRODUCTION = """## Times

Whole `register` calls with five targets and an unknown load, each in a fresh process. The package is imported and a
mesh of 200 nodes registered beforehand, so that only the mesh is new. Medians over repeats that differ in the noise
and, on the dome (4,227 nodes), in the event: development events whose model is right, one of every kind in turn. The
pull on 20,000 nodes is simulated by our own solver, so its body error contains no model error. CPU: summed over all
threads. Stages below 2 % are left out.
"""

#: Work counters that are shown.
WORK = ("passes", "factorisations", "right_hand_sides", "solves", "iterations", "sweeps")

#: Stages that take less than this share of a call are left out.
LEAST_SHARE = 0.02


def section() -> str:
    """Return the page's section, empty without an archive."""
    return tables(read_archive(ARCHIVE)) if ARCHIVE.exists() else ""


def tables(answer: dict) -> str:
    """Return the section of an archive."""
    versions = ", ".join(f"{name} {number}" for name, number in answer["versions"].items())
    runs = [run for some in answer["runs"].values() for run in some]
    lines = [
        INTRODUCTION,
        f"`{answer['command']}`, {answer['date']}, commit {answer['commit']}"
        f"{' with changed files' if answer['changed_files'] else ''}, {answer['machine']['processor']}, "
        f"{answer['machine']['cores']} cores, {answer['threads']} threads; {versions}. `import tissuereg`: "
        f"{_median(run['import']['wall_s'] for run in runs):.2f} s; the small mesh, including lazy imports: "
        f"{_median(run['small']['wall_s'] for run in runs):.2f} s.",
        "",
        "| call | n | wall, s | goal | least to most | CPU, s | body, mm (moved) | work | stages, s |",
        "| --- " * 9 + "|",
    ]
    for case, name, title, goal in ROWS:
        calls = [call for run in answer["runs"].get(case, []) for call in run["calls"] if call["call"] == name]
        lines += [_row(title, goal, calls)] if calls else []
    return "\n".join(lines) + "\n"


def _row(title: str, goal: float, calls: list[dict]) -> str:
    wall = [call["wall_s"] for call in calls]
    body, moved = (_median(call[key] for call in calls) for key in ("body_mm", "moved_mm"))
    work = ", ".join(f"{name.replace('_', ' ')} {_median(call['work'][name] for call in calls):,.0f}" for name in WORK)
    stages = {name: _median(call["stages_s"].get(name, 0.0) for call in calls) for name in calls[0]["stages_s"]}
    listed = sorted((-value, name) for name, value in stages.items() if name != "total")
    shown = ", ".join(f"{name} {-value:.2f}" for value, name in listed if -value >= LEAST_SHARE * stages["total"])
    cells = [
        title,
        str(len(calls)),
        f"{_median(wall):.2f}",
        f"{goal:g}",
        f"{min(wall):.2f} to {max(wall):.2f}",
        f"{_median(call['cpu_s'] for call in calls):.2f}",
        f"{body:.2f} ({moved:.2f})",
        work,
        shown,
    ]
    return "| " + " | ".join(cells) + " |"


def _median(values) -> float:
    return float(np.median(list(values)))
