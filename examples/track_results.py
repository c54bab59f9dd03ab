"""Track a body whose physics simulation is another program's: its result files drive the tracker.

    python examples/track_results.py --make DIR           # writes such files, and a recording
    python examples/track_results.py --data DIR [--json FILE]

DIR holds ``body.vtu`` (the undeformed mesh with its node set ``fixed``), ``push_SHARE.vtu`` for several shares of the
actuator's stroke (point data ``displacement``, mm, at the nodes of that mesh), ``targets.csv``, ``reference.csv``
(``marker,x_mm,y_mm,z_mm``) and ``recording.csv`` (``time_s,share,marker,x_mm,y_mm,z_mm``; a marker that was not seen is
left out). Between the files the simulation is interpolated. Where DIR also has ``truth.csv``
(``time_s,x_mm,y_mm,z_mm`` of the target ``lesion``), errors are stated.

The files of ``--make`` come from ten-node elements of the package's own solver, which stand for another program; the
body that is measured is softer, and is pushed in a direction that is off.
"""

import argparse
import csv
import json
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.io.meshes import write_vtu
from tissuereg.phantom.event import LESION_MM
from tissuereg.tracking import TablePhysics, fitted_prior

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
N_FRAMES, HZ, STD_MM = 12, 40.0, 0.1


def make(folder: Path) -> None:
    """Write result files of a simulation, and a recording of a body that behaves otherwise."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = tr.phantom.phantom_mesh("small")
    simulator = tr.Simulator(mesh, element="tet10")
    pad = mesh.surface_nodes_within((40.0, 0.0, 25.0), 25.0)

    def fields(young: float, push: tuple[float, float, float], shares: np.ndarray) -> list[np.ndarray]:
        found, start = [], None
        for share in shares:
            forces = np.zeros_like(mesh.nodes)
            forces[pad] = share * np.asarray(push) / len(pad)
            solved = simulator.solve(tr.Load(forces=forces), tr.Material(young, 0.45), tolerance=1e-6, start=start)
            start = solved.all_displacement
            found.append(solved.displacement)
        return found

    write_vtu(folder / "body.vtu", mesh)
    for share, field in zip(SHARES, fields(10.0, (-3000.0, 0.0, 0.0), np.array(SHARES)), strict=True):
        write_vtu(folder / f"push_{share}.vtu", mesh, {"displacement": field})
    rng = np.random.default_rng(0)
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    places = mesh.nodes[rng.choice(free, 15, replace=False)]
    names = tuple(f"P{i + 1}" for i in range(len(places)))
    seen, inner = MarkerObservation(mesh, places, names), TargetObservation(mesh, {"lesion": LESION_MM})
    shares = np.linspace(0.1, 1.0, N_FRAMES)
    recording, truth = [], []
    for k, (share, field) in enumerate(zip(shares, fields(8.0, (-3000.0, 500.0, 300.0), shares), strict=True)):
        measured = places + seen.predict(field[seen.nodes]) + STD_MM * rng.standard_normal(places.shape)
        truth.append((k / HZ, *(np.asarray(LESION_MM) + inner.predict(field[inner.nodes])[0])))
        # One marker is out of sight in every frame.
        rows = zip(names, measured, strict=True)
        recording += [(k / HZ, share, name, *row) for i, (name, row) in enumerate(rows) if i != k]
    _write(folder / "reference.csv", "marker,x_mm,y_mm,z_mm", [(n, *row) for n, row in zip(names, places, strict=True)])
    _write(folder / "targets.csv", "target,x_mm,y_mm,z_mm", [("lesion", *LESION_MM)])
    _write(folder / "recording.csv", "time_s,share,marker,x_mm,y_mm,z_mm", recording)
    _write(folder / "truth.csv", "time_s,x_mm,y_mm,z_mm", truth)


def _write(path: Path, head: str, rows: list[tuple]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head.split(","))
        writer.writerows(rows)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _place(row: dict[str, str]) -> list[float]:
    return [float(row[axis]) for axis in ("x_mm", "y_mm", "z_mm")]


def frames_of(folder: Path, names: tuple[str, ...]) -> list[tuple[float, np.ndarray, float]]:
    """Return time, measured places (NaN = not seen) and share of each frame of a recording."""
    frames: dict[float, tuple[np.ndarray, float]] = {}
    for row in _rows(folder / "recording.csv"):
        measured, _ = frames.setdefault(float(row["time_s"]), (np.full((len(names), 3), np.nan), float(row["share"])))
        measured[names.index(row["marker"])] = _place(row)
    return [(time_s, *frame) for time_s, frame in sorted(frames.items())]


def track(folder: Path) -> dict:
    """Return the tracked target of every frame."""
    mesh = tr.read_mesh(folder / "body.vtu")
    results = sorted(folder.glob("push_*.vtu"))
    physics = TablePhysics.from_files([float(path.stem.removeprefix("push_")) for path in results], results, mesh)
    markers = _rows(folder / "reference.csv")
    names = tuple(row["marker"] for row in markers)
    tracker = tr.Tracker(
        tr.Registrar(
            mesh,
            tr.Markers([_place(row) for row in markers], std=STD_MM, names=names),
            fitted_prior(mesh, largest_mm=3.0),
            tr.read_targets(folder / "targets.csv"),
        ),
        simulator=physics,
    )
    truth = {}
    if (folder / "truth.csv").exists():
        truth = {float(row["time_s"]): np.array(_place(row)) for row in _rows(folder / "truth.csv")}
    inner = tracker.registrar.attached.targets
    told = []
    for time_s, measured, share in frames_of(folder, names):
        result = tracker.step(measured, time_s, actuator=share)
        frame = {"time_s": time_s, "lesion_mm": result.target("lesion").mean.tolist(), "trust": result.trust.ok}
        if time_s in truth:
            field = physics.field(share)
            simulated = inner.reference + inner.predict(field[inner.nodes])
            frame["simulated_off_mm"] = float(np.linalg.norm(simulated[0] - truth[time_s]))
            frame["tracked_off_mm"] = float(np.linalg.norm(result.target("lesion").mean - truth[time_s]))
        told.append(frame)
    return {"schema": "tissuereg.track-results/1", "frames": told}


def main() -> None:
    """Write the files, or track."""
    parser = argparse.ArgumentParser(description="Track a body by the result files of another solver.")
    parser.add_argument("--make", type=Path, metavar="DIR", help="write result files and a recording")
    parser.add_argument("--data", type=Path, metavar="DIR", help="files to track with")
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    if given.make is None and given.data is None:
        parser.error("one of --make and --data is needed")
    if given.make is not None:
        make(given.make)
    if given.data is None:
        return
    answer = track(given.data)
    for frame in answer["frames"]:
        off = ""
        if "tracked_off_mm" in frame:
            off = f", simulated off by {frame['simulated_off_mm']:.2f}, tracked by {frame['tracked_off_mm']:.2f} mm"
        print(f"{frame['time_s']:6.3f} s  lesion {np.round(frame['lesion_mm'], 2)}{off}")
    if given.json is not None:
        given.json.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
