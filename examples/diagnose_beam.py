"""What a simulation of the measured silicone beam gets wrong: a weight left out, a marker that slips, no more.

    python examples/diagnose_beam.py --data DIR [--only NAME ...] [--young 263.8] [--out DIR] [--json FILE]

DIR holds ``beam.stl`` and recordings as described in `beam.py`. Every recording is diagnosed twice: with the beam's own
weight in the believed model and without. Each time an experiment folder is written first, under --out if it is given.
It holds the recording and, before it, those of the lightest load that was recorded twice or more.

The beam swings after its release, which a static model cannot describe. So a recording is one static frame: the mean of
its last second, less where the markers were while the beam was held level. Noise is how far markers wander while held,
and, as a share of the motion, what recordings of one load differ by. Markers on the holder ride on a rigid piece of
mesh behind the clamped face.
"""

import argparse
import csv
import itertools
import json
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from beam import DENSITY_G_PER_CM3, FITTED, HELD_OUT, HOLDER, LOADS_N, POISSON

import tissuereg as tr
from tissuereg.experiment.experiment import Actuator, BodyWeight, Boundary, Case, Experiment
from tissuereg.io.cases import write_histories
from tissuereg.io.experiment_keys import APPLIED_CSV, MARKERS_CSV
from tissuereg.io.meshes import write_vtu
from tissuereg.io.surfaces import read_triangles

MARKERS = (*FITTED, HELD_OUT, *HOLDER)

#: Longest edge along the axes, and how far the holder reaches beyond the beam's sides, mm.
EDGE_MM, HOLDER_MM = 10.0, 15.0

#: Frames before this time are held level, those of the last second are at rest.
LEVEL_UNTIL_S, REST_S = -0.05, 1.0

#: The modulus is believed to this share.
YOUNG_SPREAD = 0.1

#: From one recording to the next on the session's clock, s.
APART_S = 10.0


@dataclass(frozen=True)
class Trial:
    """One recording: weight that hangs in N; where markers were while held, how far they wandered and moved, mm."""

    name: str
    newton: float
    level: np.ndarray
    wandered: np.ndarray
    moved: np.ndarray


def read_trials(data: Path) -> list[Trial]:
    """Return all recordings of a folder, lightest load first."""
    trials = []
    for load, newton in sorted(LOADS_N.items(), key=lambda item: item[1]):
        for path in sorted(data.glob(f"{load}_*.csv")):
            with path.open(newline="", encoding="utf-8") as stream:
                rows = list(csv.DictReader(stream))
            clock = np.array([float(row["t_s"]) for row in rows])
            cells = [[[row[f"{m}_{axis}_mm"] for axis in "xyz"] for m in MARKERS] for row in rows]
            track = np.array([[[float(x or "nan") for x in place] for place in frame] for frame in cells])
            held, rest = track[clock < LEVEL_UNTIL_S], track[clock > clock[-1] - REST_S]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # a marker that was never seen stays without a place
                level, wandered, at_rest = np.nanmedian(held, 0), np.nanstd(held, 0), np.nanmean(rest, 0)
            trials.append(Trial(path.stem, newton, level, wandered, at_rest - level))
    return trials


def repeated(trials: Sequence[Trial]) -> list[Trial]:
    """Return the recordings of the lightest load that has two or more."""
    for _, group in itertools.groupby(trials, key=lambda trial: trial.newton):
        several = list(group)
        if len(several) > 1:
            return several
    return []


def noise_of(repeats: Sequence[Trial]) -> tuple[float, float]:
    """Return how far a coordinate wanders while held in mm, and between recordings of one load over the motion."""
    wandered, moved = (np.array([getattr(trial, key) for trial in repeats]) for key in ("wandered", "moved"))
    between = np.nanmean(np.nanvar(moved, axis=0, ddof=1)) / np.nanmean((moved**2).sum(axis=-1))
    return float(np.sqrt(np.nanmean(wandered**2))), float(np.sqrt(between))


def blocks(low: Sequence[float], high: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and tetrahedra of a box cut into bricks of six (Kuhn 1960)."""
    axes = [np.linspace(a, b, int(np.ceil((b - a) / EDGE_MM)) + 1) for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape([len(axis) for axis in axes])
    tets = []
    for order in itertools.permutations(range(3)):
        steps = np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], axis=0)
        if np.linalg.det(np.eye(3)[list(order)]) < 0:
            steps = steps[[0, 2, 1, 3]]
        corners = [
            number[tuple(slice(s, n - 1 + s) for s, n in zip(step, number.shape, strict=True))] for step in steps
        ]
        tets.append(np.stack(corners, axis=-1).reshape(-1, 4))
    return nodes, np.concatenate(tets)


def beam_and_holder(stl: Path) -> tr.Mesh:
    """Return the beam in the frame of the recordings, and a plate behind its clamped face for the holder's markers."""
    width, height, length = np.sort(np.ptp(read_triangles(stl).vertices, axis=0))
    beam, beam_tets = blocks((-length, 0.0, 0.0), (0.0, width, height))
    plate = (-length - EDGE_MM, -HOLDER_MM, 0.0), (-length, width + HOLDER_MM, height)
    holder, holder_tets = blocks(*plate)
    top = np.unique(beam[:, 2])[-2]
    sets = {
        "clamp": np.flatnonzero(beam[:, 0] == -length),
        "tip": np.flatnonzero((beam[:, 0] == 0.0) & (beam[:, 2] >= top)),
        "holder": len(beam) + np.arange(len(holder)),
    }
    return tr.Mesh(np.concatenate([beam, holder]), np.concatenate([beam_tets, len(beam) + holder_tets]), sets)


def write_rig(
    folder: Path, mesh: tr.Mesh, trials: Sequence[Trial], young: float, weighs: bool, noise: tuple[float, float]
) -> None:
    """Write an experiment folder; markers move from where the last trial had them."""
    folder.mkdir(parents=True, exist_ok=True)
    write_vtu(folder / "mesh.vtu", mesh)
    seen = np.isfinite(trials[-1].level).all(axis=1)
    names = tuple(name for name, has_place in zip(MARKERS, seen, strict=True) if has_place)
    level = trials[-1].level[seen]
    cases = {}
    for number, trial in enumerate(trials):
        clock = np.array([APART_S * number])
        hangs = {"weight": np.array([[0.0, 0.0, -1000.0 * trial.newton]])} if trial.newton else {}
        cases[trial.name] = Case(trial.name, clock, (level + trial.moved[seen])[None], applied_forces=hangs)
    places = {n: (c.times, {m: c.markers[:, i] for i, m in enumerate(names)}) for n, c in cases.items()}
    write_histories(folder / "markers.csv", MARKERS_CSV, places)
    pads = ()
    if any(case.applied_forces for case in cases.values()):
        pads = (Actuator("weight", mesh.node_set("tip"), "force", rule="tip"),)
        given = {name: (case.times, case.applied_forces) for name, case in cases.items() if case.applied_forces}
        write_histories(folder / "forces_applied.csv", APPLIED_CSV, given)
    held = tuple(Boundary(name, mesh.node_set(name), rule=name) for name in ("clamp", "holder"))
    believed = Experiment(
        folder.name,
        folder,
        folder / "mesh.vtu",
        mesh,
        tr.Material(young, POISSON, density=DENSITY_G_PER_CM3),
        YOUNG_SPREAD * young,
        None,
        BodyWeight(np.array([0.0, 0.0, -1.0]), in_reference=False) if weighs else None,
        held,
        pads,
        names,
        level,
        noise[0],
        {},
        cases,
        trial_share=noise[1],
    )
    tr.write_experiment(believed, folder / "experiment.toml")


def summary_of(name: str, weighs: bool, folder: Path) -> dict[str, object]:
    """Diagnose an experiment folder, leave the answer in it, print a row and return it."""
    begin = time.perf_counter()
    diagnosis = tr.diagnose(tr.read_experiment(folder), element="tet10")
    seconds = time.perf_counter() - begin
    diagnosis.save(folder)
    answer = diagnosis.to_json()
    belief = "with weight" if weighs else "weight left out"
    print(f"{name:14s} {belief:16s} {answer['verdict']:12s} p_misfit {answer['p_misfit']:.2g}, {seconds:.0f} s")
    for cause in answer["causes"]:
        proof = cause["held_out"]
        left = " / ".join(f"{proof[f'rms_{key}_mm']:.2f}" for key in ("base", "named", "generic")) if proof else "none"
        tied = " or ".join(cause["group"])
        print(f"    {tied}, P = {cause['probability']:.2f}, held out {left} mm: {cause['sentence']}")
    row = {key: answer[key] for key in ("verdict", "causes", "p_misfit", "candidates")}
    return {"recording": name, "weight_believed": weighs, "seconds": seconds, **row}


def main() -> int:
    """Diagnose every recording, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with beam.stl and the recordings")
    parser.add_argument("--only", action="append", help="a RECORDING_heavy or RECORDING_weightless (default: all)")
    parser.add_argument("--young", type=float, default=263.8, help="believed Young's modulus in kPa (default 263.8)")
    parser.add_argument("--out", type=Path, help="folder for experiment folders and answers; a temporary one if absent")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    trials = read_trials(options.data)
    repeats = repeated(trials)
    if not repeats:
        print(
            f"two recordings of one load must be in {options.data}: the noise is estimated from them", file=sys.stderr
        )
        return 2
    noise, mesh, rows = noise_of(repeats), beam_and_holder(options.data / "beam.stl"), []
    print(
        f"{mesh}; E = {options.young:g} kPa; held markers wander by {noise[0]:.3f} mm, recordings of one load differ "
        f"by {noise[1]:.1%} of the motion"
    )
    print("held out: rms of what the believed model, the named cause and a generic patch leave")
    with tempfile.TemporaryDirectory() as temporary:
        for trial, weighs in itertools.product(trials, (False, True)):
            folder = (options.out or Path(temporary)) / f"{trial.name}_{'heavy' if weighs else 'weightless'}"
            if options.only and folder.name not in options.only:
                continue
            others = [other for other in repeats if other is not trial]
            write_rig(folder, mesh, [*others, trial], options.young, weighs, noise)
            rows.append(summary_of(trial.name, weighs, folder))
    if options.json:
        document = {
            "schema": "tissuereg.diagnose-beam/1",
            "young_kpa": options.young,
            "std_mm": noise[0],
            "trial_share": noise[1],
            "rows": rows,
        }
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
