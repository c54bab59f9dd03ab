"""Open cases for tuning: ``python -m blind.generator.open_cases LEVEL DIR [fine]`` (with ``benchmarks`` on the path).

One experiment folder for every effect of the catalogue that has been solved, of detectability LEVEL, with the truth in
``DIR/truth.json``; with ``nulls`` for LEVEL bodies without an effect, two of every rig. The user's mesh has about 600
nodes, or 4,000 (fine). Markers, noise and sizes are drawn from separate seeds, so that they reveal nothing of a
sealed case; they share its solves.
"""

import json
import sys
import tempfile
from pathlib import Path

from blind.generator.cases import NotReadyError, OutOfReachError, Plan, make
from blind.generator.jobs import hidden
from blind.generator.rigs import N_RIGS
from blind.generator.store import write_case
from blind.materialise import materialise

#: Seeds of open cases begin here, far from those of sealed ones.
SEEDS = 900_000

#: Those of open bodies without an effect, and how many there are of a rig.
NULL_SEEDS, NULLS = 950_000, 2

#: Keys of the answer of an open case that are written.
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
            _write(name, experiment, folder)
            truth[name] = {key: experiment.answer[key] for key in TOLD}
            break
    (folder / "truth.json").write_text(json.dumps(truth, indent=1, default=float) + "\n", encoding="utf-8")
    return truth


def make_open_nulls(folder, rigs, draws=NULLS):
    """Write experiment folders of bodies without an effect and return their names."""
    names = []
    for rig in rigs:
        for draw in range(draws):
            name = f"null_{rig}_{draw}"
            try:
                experiment = make(Plan(name, NULL_SEEDS + 100 * rig + draw, rig, "null", mesh=draw))
            except NotReadyError:
                continue
            _write(name, experiment, folder)
            names.append(name)
    return names


def _write(name, experiment, folder):
    with tempfile.TemporaryDirectory() as stored:
        write_case(Path(stored) / f"{name}.npz", experiment)
        materialise(name, folder / name, cases=Path(stored))


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4) or sys.argv[3:] not in ([], ["fine"]):
        sys.exit("usage: python -m blind.generator.open_cases LEVEL|nulls DIR [fine]")
    if sys.argv[1] == "nulls":
        make_open_nulls(Path(sys.argv[2]), range(N_RIGS))
    else:
        make_open_cases(float(sys.argv[1]), Path(sys.argv[2]), mesh=-1 if sys.argv[3:] else 0)
