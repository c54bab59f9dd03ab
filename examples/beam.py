"""A real silicone beam, clamped at one end: registered to two motion-capture markers, tested at a third.

    python examples/beam.py --data DIR [--young 263.8] [--json FILE]

DIR holds ``beam.stl`` and recordings ``own_weight_*.csv``, ``load_52g_*.csv``, ``load_101g_*.csv`` (frames in
the beam's frame: tip face x = 0, clamp x = -100, gravity -z). Each is simulated with ten-node elements under its
own weight and load, registered to Tip-1 and Tip-2, and evaluated at Tip-3. Needs the extra ``mesh``.
"""

import argparse
import csv
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from simple import copied, rigid, spline

import tissuereg as tr
from tissuereg.io.surfaces import read_triangles

FITTED, HELD_OUT, HOLDER = ("Tip-1", "Tip-2"), "Tip-3", ("Base-1", "Base-2", "Base-3")
LOADS_N = {"own_weight": 0.0, "load_52g": 0.51012, "load_101g": 1.00062}
POISSON, DENSITY_G_PER_CM3 = 0.45, 1.07
LENGTH_MM, HEIGHT_MM, EDGE_MM = 100.0, 30.0, 8.0

#: The mesher keeps faces to about this many mm.
FACE_MM = 0.15

#: Where the markers' spheres are by the rig's drawing, 5.5 mm off the faces; used where a marker was never seen.
NOMINAL_MM = {"Tip-1": (0.0, 15.0, 35.5), "Tip-2": (0.0, -5.5, 24.0), "Tip-3": (0.0, 35.5, 6.0)}

#: Trials of one load differ by 0.06 to 0.4 mm, ten times the tracker's noise at rest.
MARKER_STD_MM = 0.15


def beam_mesh(stl: Path) -> tr.Mesh:
    """Return tetrahedra of the beam in the frame of the recordings, the clamped face held."""
    import pytetwild

    surface = read_triangles(stl)
    extent = np.ptp(surface.vertices, axis=0)
    points = surface.vertices - surface.vertices.min(axis=0)
    points = points[:, [int(np.argmax(extent)), *(axis for axis in range(3) if axis != np.argmax(extent))]]
    points[:, 0] -= LENGTH_MM
    started_in = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)  # the mesher leaves a file where it runs
        try:
            nodes, tets = pytetwild.tetrahedralize(
                np.ascontiguousarray(points),
                np.asarray(surface.triangles, np.int32),
                edge_length_fac=EDGE_MM / float(np.linalg.norm(extent)),
                quiet=True,
                num_threads=1,
            )[:2]
        finally:
            os.chdir(started_in)
    nodes, tets = np.round(np.asarray(nodes, np.float64), 6), np.asarray(tets, np.int64)
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(nodes[:, 0] < -LENGTH_MM + FACE_MM)})


def read_trial(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return, for each marker, where it was while held level and where it came to rest, mm; NaN if never seen."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    column = lambda name: np.array([float(row[name]) if row[name] else np.nan for row in rows])  # noqa: E731
    time = column("t_s")
    level, rest = time < -0.05, time > time[-1] - 1.0
    places = {}
    for marker in (*FITTED, HELD_OUT, *HOLDER):
        track = np.stack([column(f"{marker}_{axis}_mm") for axis in "xyz"], axis=1)
        whole = np.isfinite(track).all(axis=1)
        if (whole & level).any() and (whole & rest).any():
            places[marker] = (np.median(track[whole & level], axis=0), track[whole & rest].mean(axis=0))
        else:
            places[marker] = (np.array(NOMINAL_MM.get(marker, (np.nan,) * 3)), np.full(3, np.nan))
    return places


def edge_load(mesh: tr.Mesh, newton: float) -> np.ndarray:
    """Return nodal forces in mN of a weight that hangs on the top edge of the tip face, spread along the edge."""
    forces = np.zeros((mesh.n_nodes, 3))
    edge = np.flatnonzero((np.abs(mesh.nodes[:, 0]) < FACE_MM) & (mesh.nodes[:, 2] > HEIGHT_MM - FACE_MM))
    edge = edge[np.argsort(mesh.nodes[edge, 1])]
    gaps = np.diff(mesh.nodes[edge, 1])
    share = np.zeros(len(edge))
    share[:-1] += gaps / 2
    share[1:] += gaps / 2
    forces[edge, 2] = -1000.0 * newton * share / share.sum()
    return forces


def run_trial(mesh: tr.Mesh, path: Path, newton: float, young_kpa: float) -> dict[str, object]:
    """Return one row of the table: each method's prediction of the held-out marker."""
    places = read_trial(path)
    names = (*FITTED, HELD_OUT)
    reference = np.array([places[name][0] for name in names])
    rest = np.array([places[name][1] for name in names])
    seen = np.where(np.isin(names, FITTED)[:, None], rest, np.nan)
    material = tr.Material(young_kpa, POISSON, density=DENSITY_G_PER_CM3)
    load = tr.Load(forces=edge_load(mesh, newton), body_force=material.weight())
    markers = tr.Markers(reference, seen, MARKER_STD_MM, names)
    result = tr.register(tr.Body(mesh, material, "tet10"), markers, load=load)
    found = result.unseen[HELD_OUT]
    known = [name for name in (*FITTED, *HOLDER) if np.isfinite(places[name]).all()]
    before, after = (np.array([places[name][i] for name in known]) for i in (0, 1))
    measured = rest[2] - reference[2]
    missing = not np.isfinite(measured).all()
    fitted = np.isin(known, FITTED)
    return {
        "trial": path.stem,
        "load_N": newton,
        "fitted": list(FITTED),
        "held_out": HELD_OUT,
        "measured_mm": None if missing else measured.tolist(),
        "registered_mm": (found.mean - found.reference).tolist(),
        "registered_std_mm": np.sqrt(np.diag(found.covariance)).tolist(),
        "inside_region90": None if missing else found.region(0.90).contains(rest[2]),
        "simulated_mm": (found.simulation - found.reference).tolist(),
        "copied_mm": copied(before[fitted], after[fitted], reference[2]).tolist(),
        "rigid_mm": rigid(before, after, reference[2]).tolist(),
        "spline_mm": spline(before, after, reference[2]).tolist(),
        "trust": {"ok": result.trust.ok, "p_value": result.trust.p_value, "reasons": result.trust.reasons},
    }


def main() -> int:
    """Run every trial found, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with beam.stl and the recordings")
    parser.add_argument("--young", type=float, default=263.8, help="Young's modulus in kPa (default 263.8)")
    parser.add_argument("--json", type=Path, help="file for the answer")
    options = parser.parse_args()
    mesh = beam_mesh(options.data / "beam.stl")
    print(f"{mesh}; E = {options.young:g} kPa; errors at {HELD_OUT} in mm", file=sys.stderr)
    methods = ("registered", "simulated", "copied", "rigid", "spline")
    print(f"{'trial':14s} {'moved':>7s} " + " ".join(f"{m:>10s}" for m in methods) + "   inside 90 %")
    trials = []
    for name, newton in LOADS_N.items():
        for path in sorted(options.data.glob(f"{name}_*.csv")):
            row = run_trial(mesh, path, newton, options.young)
            trials.append(row)
            if row["measured_mm"] is None:
                print(f"{row['trial']:14s}   {HELD_OUT} not seen; registered {np.round(row['registered_mm'], 2)}")
                continue
            measured = np.array(row["measured_mm"])
            errors = [np.linalg.norm(np.array(row[f"{m}_mm"]) - measured) for m in methods]
            cells = " ".join(f"{e:10.2f}" for e in errors)
            print(f"{row['trial']:14s} {np.linalg.norm(measured):7.2f} {cells}   {row['inside_region90']}")
    if options.json:
        answer = {"schema": "tissuereg.beam/1", "young_kpa": options.young, "trials": trials}
        options.json.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
