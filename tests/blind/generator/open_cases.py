"""Open cases for tuning: ``python -m blind.generator.open_cases LEVEL DIR [fine]`` (with ``tests`` on the path).

One experiment folder for every effect of the catalogue that has been solved, of detectability LEVEL, with the truth in
``DIR/truth.json``; the user's mesh has about 600 nodes, or 4,000 (fine). Their markers, noise and sizes are drawn from
seeds of their own, so they tell nothing of a sealed case; they share its solves.
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


def make_open_cases(level, folder, rigs=(0, 1), report=print, mesh=0):
    """Write the experiment folders and return the truth by name."""
    truth = {}
    for index, effect in enumerate(hidden("catalogue")):
        for rig in rigs:
            name = f"{effect.id}_{index}_{rig}"
            seed = SEEDS + 37 * index + rig + int(level)
            plan = Plan(name, seed, rig, "single", (("catalogue", index),), level, mesh=mesh)
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
    if len(sys.argv) not in (3, 4) or sys.argv[3:] not in ([], ["fine"]):
        sys.exit("usage: python -m blind.generator.open_cases LEVEL DIR [fine]")
    make_open_cases(float(sys.argv[1]), Path(sys.argv[2]), mesh=-1 if sys.argv[3:] else 0)
