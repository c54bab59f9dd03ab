"""Recordings misread in units, axes and signs: each mistake must be named, and no right rig suspected.

``python -m diagnosis.misread RIG [RIG ...]`` makes eight variants of each experiment folder and prints, a line each,
what `diagnose` suspects before it computes any cause. ``--out FOLDER`` keeps the variants, to be diagnosed in full.
"""

import argparse
import csv
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg.diagnosis.readings import suspect_recording
from tissuereg.diagnosis.signals import SignalLayout

_ONE = np.eye(3)
_AXES, _MIRROR, _SIGN = _ONE[[1, 2, 0]], np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0])
_RECORDED = ("markers.csv", "reference", "actuators.csv", "forces.csv")

#: Name of each mistake: files, map of their vectors, and kinds of suspicion that name it.
VARIANTS = {
    "forces in N": (("forces.csv",), 1e-3 * _ONE, ("unit",)),
    "forces in gf": (("forces.csv",), _ONE / 9.80665, ("unit",)),
    "forces in kgf": (("forces.csv",), _ONE / 9806.65, ("unit",)),
    "actuators in m": (("actuators.csv",), 1e-3 * _ONE, ("unit",)),
    "actuators in cm": (("actuators.csv",), 0.1 * _ONE, ("unit",)),
    "axes exchanged": (_RECORDED, _AXES, ("frame",)),
    "mirrored": (_RECORDED, _MIRROR, ("mirrored", "frame")),
    "sign of a channel": (("forces.csv",), _SIGN, ("sign",)),
}


def write_variant(rig: Path, name: str, folder: Path) -> Path:
    """Copy an experiment folder with one mistake of `VARIANTS` in it, and return the copy."""
    files, turn, _ = VARIANTS[name]
    shutil.copytree(rig, folder)
    for file in files:
        if file == "reference":
            _turn_reference(folder / "experiment.toml", turn)
        elif (folder / file).exists():
            _turn_table(folder / file, turn)
    return folder


def _turn_table(path: Path, turn: np.ndarray) -> None:
    with path.open(encoding="utf-8", newline="") as stream:
        head, *rows = list(csv.reader(stream))
    for row in rows:
        values = np.array([float(cell) if cell.strip() else np.nan for cell in row[3:6]])
        seen = np.isfinite(values)
        told = turn @ np.where(seen, values, 0.0)
        told[(np.abs(turn) @ ~seen) > 0.0] = np.nan
        row[3:6] = ["" if np.isnan(value) else f"{value:.9g}" for value in told]
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([head, *rows])


def _turn_reference(path: Path, turn: np.ndarray) -> None:
    """Turn the places of ``[markers.reference]``, one marker a line."""
    lines, inside = [], False
    for line in path.read_text(encoding="utf-8").splitlines():
        inside = line.startswith("[markers.reference]") or (inside and not line.startswith("["))
        found = re.fullmatch(r"(\S+\s*=\s*)\[(.*)\]", line) if inside else None
        if found:
            place = turn @ np.array([float(one) for one in found[2].split(",")])
            line = f"{found[1]}{[round(float(value), 6) for value in place]}"
        lines.append(line)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def told(folder: Path) -> tuple[str, str]:
    """Return the kind and the sentence of what `diagnose` suspects of an experiment folder; empty if nothing."""
    experiment = tr.read_experiment(folder)
    found = suspect_recording(experiment, SignalLayout(experiment), element="tet4", threads=1)
    return (found[0].kind, found[0].sentence) if found else ("", "")


def main(arguments: Sequence[str] | None = None) -> int:
    """Make and examine the variants of the given rigs; the exit code is the number of wrong answers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--right-only", action="store_true", help="only the rigs as they are")
    given = parser.parse_args(arguments)
    wrong = 0
    with tempfile.TemporaryDirectory() as scratch:
        for rig in given.rigs:
            kind, sentence = told(rig)
            wrong += kind != ""
            print(f"{'ok   ' if kind == '' else 'WRONG'} {rig.name}, as it is: {sentence or 'nothing'}")
            for name in () if given.right_only else VARIANTS:
                place = (given.out or Path(scratch)) / f"{rig.name}-{name.replace(' ', '-')}"
                kind, sentence = told(write_variant(rig, name, place))
                good = kind in VARIANTS[name][2]
                wrong += not good
                print(f"{'ok   ' if good else 'WRONG'} {rig.name}, {name}: {sentence or 'nothing'}")
    return wrong


if __name__ == "__main__":
    raise SystemExit(main())
