"""The page of the measured bodies, written from the archive."""

from typing import Any

import numpy as np

from real.events import section

#: From the description that comes with the data: mean over draws, um.
QUOTED = {
    20: {"rigid": 0.91, "affine": 6.4, "spline": 2.0, "linear layer": 0.75},
    60: {"rigid": 0.92, "affine": 3.7, "spline": 2.2, "linear layer": 0.77},
}

HEAD = """# Measured bodies

Written by `make -C benchmarks/real` from `archive/`; edit neither. The
recordings are public and not part of this repository; the command finds them in `../shared/data`.

## A hydrogel under a ball

Beads in a polyacrylamide gel, tracked before and after a ball was pressed into its top. The markers are beads at a
height of 62 to 76 um, chosen by farthest-point sampling in five draws; the held-out targets are {n_targets} beads per
draw at 10 to 50 um. Ball, load, stiffness and the drift of the microscope are unknown, and nothing
is told: `register(gel, markers)`. The mesh extends 130 um beyond
the field of view, as the gel does. Draws 0 and 1 were used for development.

Root mean square 3-D error at the targets, um; about 0.3 um of it is the targets' own noise. Coverage: share of targets
whose measured place lies in the 90 % region of registration and bead noise together. Rigid, affine, spline and linear
layer are quoted from the description of the data and have their own targets.

"""

BEAM = """
## A silicone beam

Clamped at one end, tracked by motion capture; registered to Tip-1 and Tip-2 without `load`, evaluated at the held-out
marker Tip-3 (`element="tet10"`).

"""


def page(answer: dict[str, Any]) -> str:
    """Return the page of an archive."""
    rows = answer["hydrogel"]
    text = HEAD.format(n_targets=answer["n_targets"])
    text += "| markers | none | rigid | affine | spline | linear layer | registered | draws | coverage | flagged |\n"
    text += "| --- " * 10 + "|\n"
    for n_markers, quoted in QUOTED.items():
        own = [row for row in rows if row["n_markers"] == n_markers]
        mean = {
            name: float(np.mean([row[name] for row in own])) for name in ("none", "registered", "coverage90", "flagged")
        }
        draws = ", ".join(f"{row['registered']:.2f}" for row in own)
        others = " | ".join(f"{value}" for value in quoted.values())
        text += (
            f"| {n_markers} | {mean['none']:.2f} | {others} | **{mean['registered']:.2f}** | {draws} "
            f"| {mean['coverage90']:.0%} | {mean['flagged']:.0%} |\n"
        )
    text += "\nBy axis (x, y, z), mean over draws: " + "; ".join(_by_axis(rows, n) for n in QUOTED) + ".\n"
    text += BEAM + "| trial | moved, mm | error, mm | standard deviations, mm | inside 90 % |\n" + "| --- " * 5 + "|\n"
    for row in answer["beam"]:
        spread = " x ".join(f"{value:.2f}" for value in row["std_xyz_mm"])
        inside = "yes" if row["inside_region90"] else "no"
        text += f"| {row['trial']} | {row['moved_mm']:.2f} | {row['error_mm']:.2f} | {spread} | {inside} |\n"
    return text + section(answer["events"])


def _by_axis(rows: list[dict[str, Any]], n_markers: int) -> str:
    own = [row for row in rows if row["n_markers"] == n_markers]
    off = np.mean([row["registered_xyz"] for row in own], axis=0)
    mean = np.mean([row["mean_xyz"] for row in own], axis=0)
    one = lambda values: ", ".join(f"{value:.2f}" for value in values)  # noqa: E731
    return f"{n_markers} markers {one(off)} um, of which common to all targets {one(mean)} um"
