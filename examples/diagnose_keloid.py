"""Skin with a keloid, pulled between two pads on a living arm: what a plain slab of one soft material gets wrong.

    python examples/diagnose_keloid.py --data DIR [--out DIR] [--coarse] [--json FILE]

DIR holds recordings ``*.npz`` (``points_mm`` tracked in images, ``moving_pad_mm`` and ``fixed_pad_mm`` as images show
them; ``force_N`` and ``stroke_mm`` on a clock of their own) and ``mesh.msh``, the skin as triangles with named edges
``moving_pad*`` and ``fixed_pad*``. Two experiment folders are written and diagnosed for each recording: ``images``, in
which the pad moves as in the images, and ``stroke``, in which it moves as measured by the stroke sensor.

Our choices: a slab 4 mm thick represents plane stress; pads grip both of its faces. The skin goes on beyond the
mesh: its sides along the pull are held, its ends are free, for skin that is pushed together goes slack. Surroundings,
thickness and nu were chosen after others had been tried on one recording, and what is named depends on them
(docs/diagnose-real.md). Tracks do not contain depth, so those cells stay empty. Believed is a neo-Hookean solid of one
modulus, that of the first fifth of the force curve, known to a factor of e. Named regions of the mesh are hidden: they
are used only to check whether an inclusion that was found lies in them.
"""

import argparse
import itertools
import json
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Delaunay, KDTree

import tissuereg as tr
from tissuereg.diagnosis.answer import BodyDiagnosis
from tissuereg.io.cases import write_histories
from tissuereg.io.experiment_keys import ACTUATORS_CSV, FORCES_CSV, MARKERS_CSV
from tissuereg.io.foreign import read_grid
from tissuereg.io.toml_text import write_toml
from tissuereg.simulation.experiment import simulate_plain

THICKNESS_MM, POISSON = 4.0, 0.4
PADS = ("moving_pad", "fixed_pad")

#: Edges of elements in mm: between the pads, growth for every mm away from there, and the longest.
EDGES_MM = {"fine": (1.8, 0.25, 9.0), "coarse": (2.7, 0.4, 12.0)}
FRAMES = {"fine": 14, "coarse": 12}
MARKERS = {"fine": 40, "coarse": 25}

#: Tracks nearer to a pad see a part of the pad itself: the window of an image correlation is about as wide.
PAD_WINDOW_MM = 2.0

#: Number of neighbouring tracks from which the roughness of the tracked field is estimated.
NEIGHBOURS = 16

#: Part of the pull in which skin is soft, and the modulus is read off.
SOFT_PART = 0.2

#: The images' rate is not known: one second a frame.
FRAME_S = 1.0


@dataclass(frozen=True)
class Recording:
    """One pull: tracks in images, force and stroke brought to the clock of the images."""

    name: str
    points: np.ndarray  # (n_frames, n_points, 2) mm
    pad: np.ndarray  # (n_frames, 2) mm, of the moving pad
    force: np.ndarray  # (n_frames,) mN on the body along the pull
    stroke: np.ndarray  # (n_frames,) mm along the pull
    fixed_pad: np.ndarray  # (2,) mm, edge of the fixed pad


@dataclass(frozen=True)
class Plane:
    """The triangles of the skin; `regions` are hidden from the diagnosis."""

    points: np.ndarray  # (n, 2) mm, in the frame of the tracks
    triangles: np.ndarray
    pads: dict[str, np.ndarray]  # nodes
    regions: dict[str, np.ndarray]  # triangles


def read_recording(path: Path) -> Recording:
    """Return a recording; both clocks run evenly from the same start to the same end."""
    with np.load(path) as data:
        points, pad = data["points_mm"].astype(float), data["moving_pad_mm"].astype(float)
        images, sensors = np.linspace(0.0, 1.0, len(points)), np.linspace(0.0, 1.0, len(data["force_N"]))
        force, stroke = (np.interp(images, sensors, data[key]) for key in ("force_N", "stroke_mm"))
        fixed = data["fixed_pad_mm"].astype(float).mean(axis=0)
    return Recording(path.stem, points, pad, 1000.0 * force, stroke, fixed)


def read_plane(path: Path, recording: Recording) -> Plane:
    """Return the skin with x = 0 at the moving pad's edge that faces the fixed pad, and y = 0 amid it."""
    read = read_grid(path, "mesh")
    edges = {pad: [nodes for name, nodes in read.node_sets.items() if name.startswith(pad)] for pad in PADS}
    pads = {pad: np.unique(np.concatenate(nodes)) for pad, nodes in edges.items()}
    named = [(name, block.corners) for block in read.blocks if block.kind == "triangle" for name in block.groups]
    regions = {name: np.concatenate([rows for other, rows in named if other == name]) for name, _ in named}
    points, triangles = read.points[:, :2], read.of_kind("triangle")
    at = points[pads["moving_pad"]]
    edge = at[:, 0].max() if recording.fixed_pad[0] > 0 else at[:, 0].min()
    return Plane(points - [edge, 0.5 * (at[:, 1].min() + at[:, 1].max())], triangles, pads, regions)


def inside(places: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return which places (n, 2) lie in one of the triangles."""
    corners = points[triangles]
    _, near = KDTree(corners.mean(axis=1)).query(places, k=min(12, len(triangles)))
    a, b, c = (corners[near, i] for i in range(3))
    cross = lambda p, q: p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]  # noqa: E731
    place = places[:, None]
    sides = np.stack([cross(b - a, place - a), cross(c - b, place - b), cross(a - c, place - c)])
    return ((sides >= -1e-9).all(axis=0) | (sides <= 1e-9).all(axis=0)).any(axis=1)


def thinned_outline(plane: Plane, size: np.ndarray) -> list[int]:
    """Return nodes of the outlines: corners, and others about `size` (n_nodes,) apart."""
    a, b, c = (plane.points[plane.triangles[:, i]] for i in range(3))
    turned = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where(turned[:, None], plane.triangles[:, ::-1], plane.triangles)
    sides = {(int(one), int(other)) for t in triangles for one, other in zip(t, np.roll(t, -1), strict=True)}
    follows = {one: other for one, other in sides if (other, one) not in sides}
    chosen: list[int] = []
    while follows:
        loop = [min(follows)]
        while loop[-1] in follows:
            loop.append(follows.pop(loop[-1]))
        way = np.diff(plane.points[loop], axis=0)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        corners = np.flatnonzero((way * np.roll(way, 1, axis=0)).sum(axis=1) < 0.8)
        first = int(corners[0]) if len(corners) else 0
        loop = loop[first:-1] + loop[: first + 1]
        stops = [0, *(corners - first)[1:], len(loop) - 1]
        for begin, end in itertools.pairwise(stops):
            part = np.array(loop[begin : end + 1])
            length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(plane.points[part], axis=0), axis=1))])
            pieces = int(np.ceil(length[-1] / size[part].min()))
            wanted = np.linspace(0.0, length[-1], pieces + 1)[:-1]
            chosen += part[np.abs(length[:, None] - wanted).argmin(axis=0)].tolist()
    return sorted(set(chosen))


def thinned(plane: Plane, near: np.ndarray, build: str) -> list[int]:
    """Return nodes of the plane, the outlines' first: close together between the pads, far apart elsewhere."""
    least, growth, most = EDGES_MM[build]
    busy = KDTree(np.concatenate([near, *(plane.points[nodes] for nodes in plane.pads.values())]))
    size = np.minimum(least + growth * busy.query(plane.points)[0], most)
    kept = thinned_outline(plane, size)
    tree, blocked = KDTree(plane.points), np.zeros(len(plane.points), bool)
    for node in kept:
        blocked[tree.query_ball_point(plane.points[node], 0.8 * size[node])] = True
    for node in np.argsort(size, kind="stable").tolist():
        if not blocked[node]:
            kept.append(node)
            blocked[tree.query_ball_point(plane.points[node], 0.8 * size[node])] = True
    return kept


def slab(plane: Plane, near: np.ndarray, build: str) -> tr.Mesh:
    """Return one layer of tetrahedra on a thinned choice of the plane's nodes, small near places (n, 2).

    Pads are holes of the plane; here they are filled, and both faces of the skin are held there.
    """
    flat, boxes = plane.points[thinned(plane, near, build)], {}
    for pad, nodes in plane.pads.items():
        boxes[pad] = box = np.array([plane.points[nodes].min(axis=0), plane.points[nodes].max(axis=0)])
        steps = np.ceil((box[1] - box[0]) / EDGES_MM[build][0]).astype(int)
        rows = [np.linspace(low, high, n + 1)[1:-1] for low, high, n in zip(*box, steps, strict=True)]
        flat = np.concatenate([flat, np.stack(np.meshgrid(*rows), axis=-1).reshape(-1, 2)])
    triangles = Delaunay(flat).simplices.astype(np.int64)
    centres = flat[triangles].mean(axis=1)
    kept = inside(centres, plane.points, plane.triangles)
    for box in boxes.values():
        kept |= within(centres, box)
    # A column over a triangle is cut in three by the order of its nodes, so that neighbours meet in the same diagonals.
    n, (a, b, c) = len(flat), np.sort(triangles[kept], axis=1).T
    tets = np.concatenate([np.stack(t, 1) for t in ((a, b, c, c + n), (a, b, b + n, c + n), (a, a + n, b + n, c + n))])
    nodes = np.concatenate([np.insert(flat, 2, z, axis=1) for z in (0.0, THICKNESS_MM)])
    p, q, r, s = (nodes[tets[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(q - p, r - p), s - p) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    sets = {pad: np.flatnonzero(within(nodes[:, :2], box)) for pad, box in boxes.items()}
    sets["sides"] = np.flatnonzero(np.isin(nodes[:, 1], [nodes[:, 1].min(), nodes[:, 1].max()]))
    return tr.Mesh(nodes, tets, sets)


def within(places: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return which places (n, 2) lie between the corners (2, 2) of a box, its edge included."""
    return ((places >= box[0] - 1e-6) & (places <= box[1] + 1e-6)).all(axis=1)


def spread_out(places: np.ndarray, count: int) -> np.ndarray:
    """Return the rows of places far apart from each other, each next the farthest from those before."""
    chosen = [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    away = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.sort(chosen)


def marker_noise(recording: Recording, frames: np.ndarray) -> float:
    """Return how far a track is from a smooth field through its neighbours, mm.

    Over time the tracks are smooth to 0.0001 mm: they were filtered, which is no measure of their error in a frame.
    """
    places = recording.points[0]
    _, near = KDTree(places).query(places, k=NEIGHBOURS)
    left = []
    for point, mine in zip(places, near, strict=True):
        x, y = (places[mine] - point).T
        basis = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))[0]
        moved = recording.points[frames][:, mine] - places[mine]
        rest = moved - np.einsum("ik,jk,fjx->fix", basis, basis, moved)
        left.append((rest**2).sum(axis=1) / (NEIGHBOURS - basis.shape[1]))
    # Over tracks the median: some are lost or see a pad.
    return float(np.sqrt(np.median(left, axis=0).mean()))


def force_noise(recording: Recording, frames: np.ndarray) -> float:
    """Return what the disagreement of the two clocks means for the force, mN.

    The load cell alone is quieter than 0.1 mN. But stroke and images differ by some hundredths of a mm from any fixed
    ratio, and the force by as much times its slope.
    """
    pad, stroke = recording.pad[:, 0], recording.stroke
    apart = pad - stroke * (pad @ stroke) / (stroke @ stroke)
    slope = np.gradient(recording.force, pad)
    return float(np.sqrt(np.mean((slope * apart)[frames] ** 2)))


def believed_modulus(folder: Path, recording: Recording) -> float:
    """Return the modulus in kPa with which the folder's model meets the soft first part of the force curve."""
    far = np.abs(recording.pad[:, 0])
    soft = (far > 0.0) & (far <= SOFT_PART * far.max())
    slope = float(far[soft] @ np.abs(recording.force[soft])) / float(far[soft] @ far[soft])
    experiment = tr.read_experiment(folder)
    case = experiment.cases["pull"]
    little = {"moving_pad": case.displacements["moving_pad"][1:2] * 0.1}
    short = replace(case, times=case.times[1:2], markers=case.markers[1:2], displacements=little, forces={})
    answer = simulate_plain(replace(experiment, cases={"pull": short}))["pull"]
    simulated = np.linalg.norm(answer.forces["moving_pad"]) / np.linalg.norm(little["moving_pad"])
    return float(experiment.material.young) * slope / float(simulated)


def write_folder(folder: Path, recording: Recording, plane: Plane, drive: str, build: str) -> None:
    """Write an experiment folder: mesh, markers, motion of the pad by images or by stroke, force along the pull."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = slab(plane, recording.points[0], build)
    sets = {f"{pad}_nodes": nodes for pad, nodes in mesh.node_sets.items()}
    np.savez(folder / "mesh.npz", nodes_mm=mesh.nodes, tets=mesh.tets, **sets)
    frames = np.unique(np.linspace(0, len(recording.points) - 1, FRAMES[build] + 1).round().astype(int))
    times = FRAME_S * frames
    pads = KDTree(np.concatenate([plane.points[nodes] for nodes in plane.pads.values()]))
    free = np.flatnonzero(pads.query(recording.points[0])[0] > PAD_WINDOW_MM)
    tracks = free[spread_out(recording.points[0, free], MARKERS[build])]
    empty = np.full(len(frames), np.nan)
    markers = {f"T{t}": np.column_stack([recording.points[frames, t], empty]) for t in tracks}
    # Stroke runs along the pull alone; images also show how the pad gives way across.
    motion = recording.pad[frames] if drive == "images" else np.outer(recording.stroke[frames], [1.0, 0.0])
    write_histories(folder / "markers.csv", MARKERS_CSV, {"pull": (times, markers)})
    write_histories(
        folder / "actuators.csv", ACTUATORS_CSV, {"pull": (times, {"moving_pad": np.insert(motion, 2, 0.0, axis=1)})}
    )
    force = np.column_stack([recording.force[frames], empty, empty])
    write_histories(folder / "forces.csv", FORCES_CSV, {"pull": (times, {"moving_pad": force})})
    content: dict[str, Any] = {
        "name": f"{recording.name}, pad moved by {drive}",
        "mesh": {"file": "mesh.npz"},
        "material": {"law": "neo-hookean", "young_kpa": [10.0, 10.0], "poisson": POISSON},
        "boundary": [{"name": name, "nodes": name, "kind": "fixed"} for name in ("fixed_pad", "sides")],
        "actuator": [{"name": "moving_pad", "nodes": "moving_pad", "kind": "displacement", "contact": "bonded"}],
        "forces": {"std_mN": round(force_noise(recording, frames), 3)},
        "markers": {
            "std_mm": round(marker_noise(recording, frames), 5),
            "reference": {f"T{t}": [*recording.points[0, t].tolist(), THICKNESS_MM] for t in tracks},
        },
    }
    write_toml(folder / "experiment.toml", content)
    young = float(f"{believed_modulus(folder, recording):.3g}")
    content["material"]["young_kpa"] = [young, young]
    write_toml(folder / "experiment.toml", content)


def place_of(centre: list[float], plane: Plane) -> dict[str, object]:
    """Return in which named region a centre lies, and how far it is from each of them in mm."""
    place = np.array([centre[:2]])
    answer: dict[str, object] = {}
    for name, triangles in plane.regions.items():
        if inside(place, plane.points, triangles)[0]:
            answer["inside"] = name
        away = np.linalg.norm(plane.points[np.unique(triangles)] - place, axis=1).min()
        answer[f"to_{name}_mm"] = 0.0 if answer.get("inside") == name else float(away)
    return answer


def summary_of(name: str, diagnosis: BodyDiagnosis, plane: Plane) -> dict[str, Any]:
    """Print what was found and return its figures."""
    document = diagnosis.to_json()
    provisional = ", provisional" if diagnosis.provisional else ""
    print(f"{name}: {diagnosis.verdict}{provisional}, p_misfit {diagnosis.p_misfit:.2g}")
    print(f"  {'cause':34s} {'probability':>11s} {'log BF':>9s} {'held out, mm':>24s} {'chi':>20s}")
    for finding, cause in zip(diagnosis.findings, document["causes"], strict=True):
        held = finding.held_out
        mm = " ".join(f"{held[f'rms_{k}_mm']:7.3f}" for k in ("base", "named", "generic")) if held else ""
        chi = " ".join(f"{held[f'chi_{k}']:6.2f}" for k in ("base", "named", "generic")) if held else ""
        print(
            f"  {' or '.join(finding.group):34s} {finding.probability:11.3f} {finding.log_bayes_factor:9.1f} "
            f"{mm:>24s} {chi:>20s}"
        )
        print(f"    {finding.sentence}")
        if finding.id == "inclusion":
            cause["place"] = place_of(finding.parameters["centre_mm"], plane)
            print(f"    its centre: {cause['place']}")
    keys = ("verdict", "provisional", "causes", "candidates", "p_misfit", "discrepancy")
    return {"name": name, **{key: document[key] for key in keys}}


def study(data: Path, out: Path, build: str, drives: list[str]) -> list[dict[str, Any]]:
    """Write, read and diagnose the folders of all recordings."""
    rows = []
    for path in sorted(data.glob("*.npz")):
        recording = read_recording(path)
        plane = read_plane(data / "mesh.msh", recording)
        for drive in drives:
            folder = out / f"{recording.name}-{drive}"
            write_folder(folder, recording, plane, drive, build)
            experiment = tr.read_experiment(folder)
            print(
                f"{folder.name}: {experiment.mesh.n_nodes} nodes, {len(experiment.marker_names)} markers, "
                f"{len(experiment.cases['pull'].times)} frames; noise {experiment.marker_std:.3g} mm, "
                f"{experiment.force_std:.3g} mN; E {experiment.material.young:.3g} kPa",
                file=sys.stderr,
            )
            diagnosis = tr.diagnose(experiment, progress=lambda step: print(f"  {step}", file=sys.stderr))
            diagnosis.save(folder)
            rows.append(summary_of(folder.name, diagnosis, plane))
    return rows


def main() -> int:
    """Diagnose the recordings of a folder, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with the recordings and mesh.msh")
    parser.add_argument("--out", type=Path, help="folder for experiment folders and answers; a temporary one if absent")
    parser.add_argument("--drive", choices=("images", "stroke"), help="only one of the two (default: both)")
    parser.add_argument("--coarse", action="store_true", help="larger elements, fewer frames and markers")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    drives = [options.drive] if options.drive else ["images", "stroke"]
    with tempfile.TemporaryDirectory() as temporary:
        rows = study(options.data, options.out or Path(temporary), "coarse" if options.coarse else "fine", drives)
    if not rows:
        print(f"no recordings in {options.data}", file=sys.stderr)
        return 2
    if options.json:
        document = {"schema": "tissuereg.diagnose-keloid/1", "rows": rows}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
