"""The page of ``tune_rivals.py``, from its archive."""

from typing import Any

import numpy as np

#: A constant stays where no other value is better by this share.
TIE = 0.02

#: Why a default is not the best of its sweep, or why a sweep ends at it.
REASONS = {
    ("linear elastic", "smooth"): "there is no third",
    ("KF-ADMM, our reconstruction", "modes"): "there is no third",
    ("LIBR", "energy_weight"): "that of the highest evidence, at every noise",
    ("PBD with observations", "n_iterations"): "more take over a tenth of a second a frame",
    ("parameter inference", "n_members"): "flat",
    ("parameter inference", "later_steps"): "each step costs as much again",
    ("PCA-26 + ES-MDA", "n_latent"): "as many as the network has latents",
    ("one-step ES in latents", "n_members"): "as in the paper",
    ("EnKF in latents", "n_members"): "as in the paper; the rest is the draw's",
}

#: Constants that are not varied.
FIXED = {
    ("parameter inference", "stiffness_std"): "where actuators are known, stiffness moves nothing; the other factor is "
    "on their motion",
    ("parameter inference", "drift"): "a body stays what it is; a tenth of the prior's deviation a moment is loose",
    ("parameter inference", "n_steps"): "of the first moment alone",
    ("PCA-26 + ES-MDA", "n_members"): "the model is linear, the ensemble's moments exact",
    ("PCA-26 + ES-MDA", "n_steps"): "the model is linear",
}

HEAD = """# How the rivals were tuned

Written by `make -C paper tune` from `paper/archive/rivals-tuning`; edit neither.

The methods of [the phantom experiment](phantom-experiment.md) have constants. Each was varied on {n} *development* rigs
(`paper/bench/twin/development`), drawn like those that are reported but with other seeds; no constant was chosen on a
reported rig. All markers are seen, with noise of 0.1 mm; the believed simulation is driven by the measured force.

A constant is varied by itself, the others at their defaults, until every default is the best of its own sweep. The
error is the mean over frames and rigs, at the buried sensor and at 200 inner points; what counts is the mean of the
two. A default stays where no value is better by two percent, or where a reason is given. Methods that live on
consecutive frames are given all of them, the others those that are scored. Slow methods are varied on fewer rigs, and
on the last push, the deepest; their errors are compared with one another, not with those of other rows.
"""

CHANGES = """## What makes them stronger than their first form

Errors on development rigs also showed what a rival lacked.

* *Rigid motion, spline and mean of the markers* know the markers alone. About the believed simulation they are far
  better; both forms are in the tables.
* *KF-ADMM* was driven by the forces that hold the simulation. Forces on the skin do not follow it, and a body that is
  pressed deep buckles under them: on one rig the prediction missed the markers by 8 mm where the simulation missed
  them by 2. Nodes under actuators (`Setting.driven`) now follow the simulation until the next correction. For a time
  they went on from where the filter had left them (`carried` of 1): then errors of one push are there in the next, and
  on a rig of scenario 2 the error over the recording is 1.2 mm in place of 0.12.
* *Parameter inference* scaled the same forces, and its members buckled. It now scales the motion of those nodes.
* *LIBR* has the body's rigid motion among its unknowns in the original, and the original of *linear elastic* holds no
  base at all. Both now let the base give, by a share of what elasticity explains.
* *PBD* meets its constraints in turn, and a hundred rounds are far from enough for light nodes. Heavier nodes, which go
  on by a share of their last change, get there in as many.
* Every method that lives on consecutive frames is given all of them, however slow it is.
"""


def page(answer: dict[str, Any]) -> str:
    """Return the page of an archive."""
    lines = [HEAD.format(n=len(answer["rigs"])), CHANGES, "## Constants\n"]
    lines.append("Value: error at the sensor / at inner points, mm. Chosen values are bold.\n")
    lines.append("| method | constant | values | rigs |\n|---|---|---|---|")
    for sweep in answer["sweeps"]:
        cells = [_value(sweep, k) for k in range(len(sweep["values"]))]
        rigs = f"{len(sweep['rigs'])}{', last push' if sweep['last'] else ''}"
        reason = REASONS.get((sweep["method"], sweep["constant"]))
        words = f"{', '.join(cells)}{'' if reason is None else f' ({reason})'}"
        beside = "".join(f", {name} {value:g}" for name, value in sweep["others"].items())
        lines.append(f"| {sweep['method']} | `{sweep['constant']}` | {words} | {rigs}{beside} |")
    if answer["pending"]:
        lines.append(f"\nStill to be run: {', '.join(' '.join(one) for one in answer['pending'])}.")
    lines.append("\nNot varied:\n\n| method | constant | why |\n|---|---|---|")
    lines += [f"| {method} | `{constant}` | {why} |" for (method, constant), why in FIXED.items()]
    lines.append("\n## All methods, with their defaults\n")
    lines.append("Means over the scored frames of development rigs, mm; *lowered by*: of the simulation's, per rig.\n")
    lines.append("| method | sensor | inner points | sensor lowered by | rigs |\n|---|---|---|---|---|")
    for row in sorted(answer["methods"], key=lambda one: -_lowered(one)):
        sensor, inner = (float(np.mean(row[part])) for part in ("sensor_mm", "inner_mm"))
        lines.append(f"| {row['method']} | {sensor:.3f} | {inner:.3f} | {_lowered(row):.0%} | {len(row['rigs'])} |")
    return "\n".join(lines) + "\n"


def errors_of(sweep: dict[str, Any]) -> list[float]:
    """Return what counts of each value of a sweep: the mean of the errors at the sensor and at inner points, mm."""
    both = [np.mean(sweep[part], axis=1) for part in ("sensor_mm", "inner_mm")]
    return [float(one) for one in np.mean(both, axis=0)]


def _lowered(row: dict[str, Any]) -> float:
    return 1.0 - float(np.mean(np.divide(row["sensor_mm"], row["simulation_sensor_mm"])))


def _value(sweep: dict[str, Any], k: int) -> str:
    value = sweep["values"][k]
    shown = f"{value:g}" if isinstance(value, float | int) and not isinstance(value, bool) else str(value).lower()
    shown = "by evidence" if value is None else shown
    sensor, inner = (float(np.mean(sweep[part][k])) for part in ("sensor_mm", "inner_mm"))
    words = f"{shown}: {sensor:.3f} / {inner:.3f}"
    return f"**{words}**" if value == sweep["default"] else words
