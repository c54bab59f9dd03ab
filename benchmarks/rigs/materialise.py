"""Writes a stored case as an experiment folder: ``PYTHONPATH=benchmarks python -m rigs.materialise CASE DIR``.

Reads no answers. A case tells what is measured and believed, and nothing else.
"""

import json
import sys
from pathlib import Path

import numpy as np

from blind.materialise import numbers, write_mesh

DATA = Path(__file__).resolve().parent / "data"
CASES, MESHES, HALVES = DATA / "cases", DATA / "meshes", DATA / "halves.csv"

#: Steps of the stored integers.
STEP_MM, STEP_MN = 1e-3, 1e-1


def case_names(half: str = "all") -> list[str]:
    """Return the names of the stored cases of a half (dev, sealed), of the third draw or of all, sorted."""
    of_rig = dict(line.split(",") for line in HALVES.read_text(encoding="utf-8").split()[1:])
    names = sorted(path.stem for path in CASES.glob("*.npz"))
    return [name for name in names if half in ("all", of_rig[rig_of(name)])]


def rig_of(case: str) -> str:
    """Return the name of a case's rig."""
    return case[:6]


def materialise(case: str, folder: Path) -> Path:
    """Write one of the stored cases as an experiment folder and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with np.load(CASES / f"{case}.npz") as stored:
        about = json.loads(str(stored["about"]))
        times = stored["times"]
        markers, targets = (numbers(stored[key], STEP_MM) for key in ("markers", "targets"))
        forces = numbers(stored["forces"], STEP_MN) if "forces" in stored else None
    (folder / "experiment.toml").write_text(about["toml"], encoding="utf-8")
    labels, pads = about["labels"], about["pads"]
    names = [f"P{k + 1}" for k in range(markers.shape[1])]
    _write(folder / "markers.csv", "marker,x_mm,y_mm,z_mm", labels, times, names, markers)
    _write(folder / "targets.csv", "target,x_mm,y_mm,z_mm", labels, times, about["targets"], targets)
    commands = np.full((len(times), len(pads), 3), np.nan)
    for row, label in enumerate(labels):
        for k, pad in enumerate(pads):
            if pad in about["strokes"].get(label, {}):
                commands[row, k] = about["shares"][row] * np.array(about["strokes"][label][pad])
    _write(folder / "actuators.csv", "actuator,x_mm,y_mm,z_mm", labels, times, pads, commands, 4, skip=True)
    if forces is not None:
        _write(folder / "forces.csv", "actuator,x_mN,y_mN,z_mN", labels, times, pads, forces, 1, skip=True)
    with np.load(MESHES / f"{rig_of(case)}.npz") as stored:
        sets = {key[4:]: stored[key] for key in stored if key.startswith("set_")}
        write_mesh(folder / "mesh.vtu", np.round(stored["nodes"].astype(float), 5), stored["tets"], sets)
    return folder


def _write(path, columns, labels, times, names, values, digits=3, skip=False) -> None:
    """Write a table of values (t, names, 3); with `skip` without the rows that are not there."""
    lines = [f"case,time_s,{columns}"]
    for label, time, row in zip(labels, times, values, strict=True):
        for name, cells in zip(names, row, strict=True):
            if skip and np.isnan(cells).all():
                continue
            texts = ["" if np.isnan(v) else f"{v:.{digits}f}" for v in cells]
            lines.append(f"{label},{time:.2f},{name},{','.join(texts)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m rigs.materialise CASE DIR")
    materialise(sys.argv[1], Path(sys.argv[2]))
