"""The beginnings of an experiment on a user's own body: a folder that runs at once, to be filled with measurements."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._arguments import place
from tissuereg._arrays import FloatArray, IntArray
from tissuereg.errors import FormatError, MeshError
from tissuereg.experiment import Simulated
from tissuereg.io.atomic import OutputError, atomic_folder, check_folder_target
from tissuereg.io.cases import write_histories
from tissuereg.io.commented import commented_toml
from tissuereg.io.experiment_keys import (
    ACTUATOR,
    ACTUATORS_CSV,
    BOUNDARY,
    FORCES,
    GRAVITY,
    MARKERS,
    MARKERS_CSV,
    MATERIAL,
    MESH,
    SIMULATED,
    TARGET,
    TOP,
)
from tissuereg.io.experiments import read_experiment
from tissuereg.io.meshes import read_mesh
from tissuereg.io.node_rules import NodeRule, nodes_by_rule, rule_for_file
from tissuereg.io.simulated import TABLES, simulated_tables
from tissuereg.mesh import Mesh
from tissuereg.simulate.experiment import simulate_plain
from tissuereg.simulate.noise import with_noise

#: Share of a pad's motion in the frames of a push.
_STROKE = np.array([0.0, 0.5, 1.0, 1.0, 0.5])

#: Of the body's extent: radius of a pad, and how far it is pushed in.
_RADIUS_SHARE, _STROKE_SHARE = 0.12, 0.04

_N_MARKERS, _N_PADS, _REST_FRAMES = 10, 2, 6

#: Share of the body's height below which nodes are held where nothing says what is.
_BASE_SHARE = 0.04


@dataclass(frozen=True)
class Begun:
    """What `new_experiment` wrote, and what it had to guess.

    Attributes
    ----------
    files : tuple of str
        Names in the folder.
    guessed : tuple of str
        One sentence each.
    """

    files: tuple[str, ...]
    guessed: tuple[str, ...]


def new_experiment(
    folder: str | os.PathLike[str],
    mesh: str | os.PathLike[str],
    *,
    fixed: NodeRule | None = None,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Begun:
    """Write the folder of an experiment with every key of the format, which `simulate` and `diagnose` take at once.

    Two pads on the surface push in one after another, ten markers and one inner target are tracked; the tables hold
    what the believed model predicts on the mesh as it is, with noise. All of this is to be replaced by the user's own.

    Parameters
    ----------
    folder : path-like
        To write; must be new or empty.
    mesh : path-like
        Tetrahedra in mm, as `read_mesh` takes them. The file stays where it is.
    fixed : str, sequence of float or mapping, optional
        What is held, as `read_mesh` takes it. Where absent, the mesh's node set ``fixed``; in a mesh without, the
        lowest nodes along z are taken.
    seed : int
        Of the noise.
    threads : int
        Threads to use; 0 takes all cores.
    progress : callable of (int, int), optional
        Called with frames solved and frames in all.

    Returns
    -------
    Begun
        Cost: about ten solves on the mesh.

    Raises
    ------
    ConvergenceError
        If no equilibrium is found under the made-up pushes.
    FormatError, MeshError
        If the mesh cannot be read, or the rule holds no node.
    OutputError
        If the folder is a file, holds anything, or cannot be written.
    """
    target = place("folder", folder, error=OutputError)
    check_folder_target(target)
    if target.is_dir() and any(target.iterdir()):
        message = f"the folder of a new experiment must be new or empty; {target} holds files"
        raise OutputError(message, where=str(target))
    mesh_file = place("mesh", mesh, error=FormatError)
    body = read_mesh(mesh_file)
    rule, guessed = _held(body, fixed)
    held = nodes_by_rule(body, rule)
    rig = _Rig.on(body, held)
    with atomic_folder(target) as draft:
        seen = Path(os.path.relpath(mesh_file.absolute(), target.absolute())).as_posix()
        tables = _tables(target.absolute().name, rule, rig)
        text = _text(tables, seen, simulated=True)
        # Read where it is written first, the mesh is named from there.
        _write_frames(draft, rig)
        (draft / "experiment.toml").write_text(
            _text(tables, mesh_file.absolute().as_posix(), simulated=False), encoding="utf-8"
        )
        experiment = read_experiment(draft, measured=False)
        answers = with_noise(experiment, simulate_plain(experiment, threads=threads, progress=progress), seed=seed)
        for table, histories in simulated_tables(experiment, answers):
            write_histories(draft / table.file, table, histories)
        (draft / "experiment.toml").write_text(text, encoding="utf-8")
        files = tuple(name for name in TABLES if (draft / name).exists())
    return Begun(files, guessed)


def _held(body: Mesh, fixed: NodeRule | None) -> tuple[str | dict[str, Any], tuple[str, ...]]:
    """Return the rule of the held nodes for the file, and what had to be guessed."""
    if fixed is not None:
        return rule_for_file(fixed, "fixed"), ()
    if "fixed" in body.node_sets and len(body.node_sets["fixed"]):
        return "fixed", ()
    low, high = body.nodes[:, 2].min(), body.nodes[:, 2].max()
    tolerance = _BASE_SHARE * (high - low)
    plane = {"plane": [0.0, 0.0, 1.0, float(low)], "tolerance_mm": float(tolerance)}
    said = f"the mesh has no node set 'fixed': all nodes within {tolerance:.3g} mm of its lowest along z are held"
    return plane, (said,)


@dataclass(frozen=True, eq=False)
class _Rig:
    """Made-up pads, markers and a target on a body; lengths in mm."""

    centres: FloatArray
    radius: float
    pushes: FloatArray
    markers: FloatArray
    target: FloatArray

    @classmethod
    def on(cls, body: Mesh, held: IntArray) -> "_Rig":
        """Put pads and markers far from what is held and from each other."""
        free = np.setdiff1d(body.surface_nodes, held)
        places, normals = body.nodes[free], _normals(body)[free]
        if not len(held) or len(free) < _N_PADS + _N_MARKERS:
            message = (
                f"the surface must have held nodes and {_N_PADS + _N_MARKERS} free ones at least for pads and markers, "
                f"got {len(held)} and {len(free)}"
            )
            raise MeshError(message, where="mesh")
        radius = _RADIUS_SHARE * body.extent
        from_held = _distance(places, body.nodes[held])
        pads = _spread(places, from_held, _N_PADS)
        away = _distance(places, places[pads])
        # Markers off the pads, if the body is large enough for that.
        off = away > radius if np.count_nonzero(away > radius) >= _N_MARKERS else away > 0
        spots = np.flatnonzero(off)
        markers = places[spots[_spread(places[spots], away[spots], _N_MARKERS)]]
        centres = body.nodes[body.tets].mean(axis=1)
        middle = np.average(centres, axis=0, weights=body.volumes)
        target = centres[np.argmin(np.linalg.norm(centres - middle, axis=1))]
        return cls(
            places[pads].round(3),
            float(np.round(radius, 2)),
            (-_STROKE_SHARE * body.extent * normals[pads]).round(3),
            markers.round(3),
            target.round(3),
        )


def _normals(body: Mesh) -> FloatArray:
    """Return outward unit normals at nodes of the surface, shape (n_nodes, 3); zero elsewhere."""
    corners = body.nodes[body.surface]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(body.nodes)
    for corner in range(3):
        np.add.at(normals, body.surface[:, corner], areas)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def _distance(points: FloatArray, others: FloatArray) -> FloatArray:
    from scipy.spatial import KDTree

    return np.asarray(KDTree(others).query(points)[0])


def _spread(points: FloatArray, distance: FloatArray, n: int) -> IntArray:
    """Return indices of `n` points, each the farthest from those chosen and from what `distance` is measured to."""
    chosen: list[int] = []
    for _ in range(n):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _tables(name: str, rule: Any, rig: _Rig) -> list[tuple[Any, Mapping[str, Any] | None]]:
    pads = [
        {
            "name": f"pad_{i + 1}",
            "nodes": {"centre_mm": centre.tolist(), "radius_mm": rig.radius},
            "kind": "displacement",
        }
        for i, centre in enumerate(rig.centres)
    ]
    markers = {f"M{i + 1}": spot.tolist() for i, spot in enumerate(rig.markers)}
    return [
        (TOP, {"name": name}),
        (MESH, {}),
        (MATERIAL, {"law": "neo-hookean", "young_kpa": [10.0, 3.0], "poisson": 0.45}),
        (GRAVITY, None),
        (BOUNDARY, {"name": "support", "nodes": rule, "kind": "fixed"}),
        *((ACTUATOR, pad) for pad in pads),
        (MARKERS, {"std_mm": 0.1, "rest_case": "rest", "reference": markers}),
        (FORCES, {"std_mN": 5.0}),
        (TARGET, {"name": "target", "reference": rig.target.tolist()}),
    ]


def _text(tables: list[tuple[Any, Mapping[str, Any] | None]], mesh: str, *, simulated: bool) -> str:
    head = [
        "An experiment to begin with, made by `tissuereg new`: replace pads, markers and tables by your own.",
        "Every key is here; those behind # may be left out. Lengths mm, forces mN, stresses kPa, times s.",
        "The tables hold what the model below says of two made-up pushes, with noise. Once they hold what you",
        "measured, delete [simulated] at the end.",
    ]
    filled = [(each, {"file": mesh} if each is MESH else values) for each, values in tables]
    said = Simulated("plain", "tet4")
    last = [(SIMULATED, {"model": said.model, "element": said.element})] if simulated else []
    return commented_toml(head, [*filled, *last])


def _write_frames(folder: Path, rig: _Rig) -> None:
    """Write what the pads do, and the frames in which markers are to be seen, at rest and under each push."""
    times = np.arange(len(_STROKE), dtype=np.float64)
    pushes: dict[str, tuple[FloatArray, dict[str, FloatArray]]] = {
        f"push_{i + 1}": (10.0 * (i + 1) + times, {f"pad_{i + 1}": _STROKE[:, None] * push + 0.0})
        for i, push in enumerate(rig.pushes)
    }
    write_histories(folder / ACTUATORS_CSV.file, ACTUATORS_CSV, pushes)
    frames = {"rest": np.arange(float(_REST_FRAMES)), **{case: given for case, (given, _) in pushes.items()}}
    names = [f"M{i + 1}" for i in range(len(rig.markers))]
    unseen: dict[str, tuple[FloatArray, dict[str, FloatArray]]] = {
        case: (given, {name: np.full((len(given), 3), np.nan) for name in names}) for case, given in frames.items()
    }
    write_histories(folder / MARKERS_CSV.file, MARKERS_CSV, unseen)
