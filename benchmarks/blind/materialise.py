"""Writes a stored case as an experiment folder: ``PYTHONPATH=benchmarks python -m blind.materialise CASE DIR``.

Reads no answers. A case tells what is measured and believed, and nothing else.
"""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parent / "data"
CASES, MESHES = DATA / "cases", DATA / "meshes"

#: Steps of the stored integers, and what stands for a missing value.
STEP_MM, STEP_MN, MISSING = 1e-4, 1e-2, -(2**31)

CASE_NAMES = ("push_x", "push_y", "push_z")
CASE_STARTS = (10.0, 30.0, 50.0)
RAMP = ([0.0, 2.0, 8.0, 10.0], [0.0, 1.0, 1.0, 0.0])


def case_names() -> list[str]:
    """Return the names of all stored cases, sorted."""
    return sorted(path.stem for path in CASES.glob("*.npz"))


def materialise(case: str, folder: Path, cases: Path = CASES) -> Path:
    """Write one of the stored cases as an experiment folder and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with np.load(cases / f"{case}.npz") as stored:
        times, mesh = stored["times"], str(stored["mesh"])
        (folder / "experiment.toml").write_text(str(stored["toml"]), encoding="utf-8")
        markers = numbers(stored["markers"], STEP_MM)
        targets = numbers(stored["targets"], STEP_MM)
        forces = numbers(stored["forces"], STEP_MN)
        strokes, target_names = stored["strokes"], [str(n) for n in stored["target_names"]]
        forces_given = bool(stored["forces_given"])
    labels = [_case_at(t) for t in times]
    names = [f"P{k + 1}" for k in range(markers.shape[1])]
    _write(folder / "markers.csv", "marker", "mm", labels, times, names, markers, 4)
    _write(folder / "targets.csv", "target", "mm", labels, times, target_names, targets, 4)
    loaded = [k for k, label in enumerate(labels) if label != "rest"]
    pushed = [labels[k] for k in loaded]
    shares = [np.interp(times[k] - CASE_STARTS[CASE_NAMES.index(labels[k])], *RAMP) for k in loaded]
    given = np.array([share * strokes[CASE_NAMES.index(name)] for share, name in zip(shares, pushed, strict=True)])
    _write(folder / "actuators.csv", "actuator", "mm", pushed, times[loaded], pushed, given[:, None], 4)
    if forces_given:
        _write(folder / "forces.csv", "actuator", "mN", pushed, times[loaded], pushed, forces[:, None], 2)
    with np.load(MESHES / mesh) as stored:
        base = np.flatnonzero(np.abs(stored["nodes"][:, 2]) < 1e-6)
        write_mesh(folder / "mesh.vtu", stored["nodes"], stored["tets"], {"base": base})
    return folder


def folder_of(case: str, work: Path, write: Callable[[str, Path], Path] = materialise) -> Path:
    """Return the experiment folder of a stored case below a work folder, written once, whole or not at all."""
    folder = work / "cases" / case
    if not folder.exists():
        partial = folder.with_suffix(".part")
        shutil.rmtree(partial, ignore_errors=True)
        write(case, partial)
        partial.rename(folder)
    return folder


def _case_at(time: float) -> str:
    later = [name for name, start in zip(CASE_NAMES, CASE_STARTS, strict=True) if time >= start]
    return later[-1] if later else "rest"


def numbers(whole: np.ndarray, step: float) -> np.ndarray:
    """Return stored integers as numbers, NaN where one is missing."""
    return np.where(whole == MISSING, np.nan, whole * step)


def _write(path, what, unit, labels, times, names, values, digits) -> None:
    """Write a table; names are those of the columns of values, or one per row where there is one column."""
    lines = [f"case,time_s,{what},x_{unit},y_{unit},z_{unit}"]
    for row, (label, time) in enumerate(zip(labels, times, strict=True)):
        for column in range(values.shape[1]):
            name = names[row] if values.shape[1] == 1 and len(names) == len(labels) else names[column]
            cells = ["" if np.isnan(v) else f"{v:.{digits}f}" for v in values[row, column]]
            lines.append(f"{label},{time:.2f},{name},{','.join(cells)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_mesh(path: Path, nodes: np.ndarray, tets: np.ndarray, sets: dict[str, np.ndarray]) -> None:
    """Write a mesh of four-node tets as .vtu; `sets`: numbers of the nodes of each set, by its name."""

    def table(name, kind, values, parts=1):
        rows = "\n".join(" ".join(str(v) for v in np.atleast_1d(row)) for row in values)
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{parts}" format="ascii">\n{rows}\n</DataArray>'
        )

    marks = "\n".join(table(name, "Int64", np.isin(np.arange(len(nodes)), s).astype(int)) for name, s in sets.items())
    text = f"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">
<UnstructuredGrid>
<Piece NumberOfPoints="{len(nodes)}" NumberOfCells="{len(tets)}">
<Points>
{table("Points", "Float64", nodes, 3)}
</Points>
<Cells>
{table("connectivity", "Int64", tets)}
{table("offsets", "Int64", 4 * (np.arange(len(tets)) + 1))}
{table("types", "Int64", np.full(len(tets), 10))}
</Cells>
<PointData>
{marks}
</PointData>
</Piece>
</UnstructuredGrid>
</VTKFile>
"""
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m blind.materialise CASE DIR")
    materialise(sys.argv[1], Path(sys.argv[2]))
