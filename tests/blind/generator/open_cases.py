"""Open cases for tuning: ``python -m blind.generator.open_cases LEVEL DIR`` (with ``tests`` on the path).

One experiment folder for every effect of the catalogue that has been solved, of detectability LEVEL, with the truth in
``DIR/truth.json``. Their markers, noise and sizes are drawn from seeds of their own, so they tell nothing of a sealed
case; they share its solves.
"""

import json
import sys
import tempfile
from pathlib import Path

from blind.generator.cases import NotReadyError, OutOfReachError, Plan, make
from blind.generator.jobs import hidden
from blind.generator.store import write_case
from blind.materialise import materialise

#: Seeds of open cases begin here, far from those of sealed ones.
SEEDS = 900_000

#: What is told of an open case.
TOLD = ("cause", "own_form", "detectability", "group_ok", "separable", "std_mm", "parameters", "effect_rms_mm")


def make_open_cases(level, folder, rigs=(0, 1), report=print):
    """Write the experiment folders and return the truth by name."""
    truth = {}
    for index, effect in enumerate(hidden("catalogue")):
        for rig in rigs:
            name = f"{effect.id}_{index}_{rig}"
            plan = Plan(name, SEEDS + 37 * index + rig + int(level), rig, "single", (("catalogue", index),), level)
            try:
                experiment = make(plan)
            except NotReadyError:
                continue
            except OutOfReachError:
                report(f"{name}: no size and noise in range has this detectability")
                continue
            with tempfile.TemporaryDirectory() as stored:
                write_case(Path(stored) / f"{name}.npz", experiment)
                materialise(name, folder / name, cases=Path(stored))
            truth[name] = {key: experiment.answer[key] for key in TOLD}
            break
    (folder / "truth.json").write_text(json.dumps(truth, indent=1, default=float) + "\n", encoding="utf-8")
    return truth


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m blind.generator.open_cases LEVEL DIR")
    make_open_cases(float(sys.argv[1]), Path(sys.argv[2]))
