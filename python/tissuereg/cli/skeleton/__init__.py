"""A first experiment on a user's own body: a folder that can be simulated at once, to be filled with measurements."""

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.cli.skeleton.rig import MadeUpRig
from tissuereg.errors import ConvergenceError, FormatError
from tissuereg.experiment.experiment import Experiment, Simulated
from tissuereg.io.atomic import OutputError, atomic_folder, check_folder_target
from tissuereg.io.cases import write_histories
from tissuereg.io.drafts import DRAFT_PREFIX, remove_stale_drafts
from tissuereg.io.experiment_keys import (
    ACTUATORS_CSV,
    MARKERS_CSV,
    ActuatorKeys,
    BoundaryKeys,
    ForcesKeys,
    GravityKeys,
    MarkersKeys,
    MaterialKeys,
    MeshKeys,
    SimulatedKeys,
    TargetKeys,
    Top,
)
from tissuereg.io.experiment_out import TABLES, path_from, simulated_tables
from tissuereg.io.experiments import read_experiment
from tissuereg.io.meshes import read_mesh
from tissuereg.io.node_rules import NodeRule, nodes_by_rule, rule_for_file
from tissuereg.io.simulated import tables_sha256
from tissuereg.io.toml import Keys
from tissuereg.io.toml_text import commented_toml
from tissuereg.simulation.experiment import CaseSimulation, simulate_plain, with_noise

#: Share of a pad's motion in the frames of a push.
_STROKE = np.array([0.0, 0.5, 1.0, 1.0, 0.5])

#: How often the pushes are halved where the body finds no equilibrium under them.
_HALVINGS = 4

_REST_FRAMES = 6

#: Share of the body's height below which nodes are held if no held nodes are given.
_BASE_SHARE = 0.04


#: Declared keys and values of every table of the file.
_Tables = list[tuple[type[Keys], Mapping[str, Any] | None]]


@dataclass(frozen=True)
class Begun:
    """Result of `new_experiment`: names of the files written, and a sentence for each thing that was guessed."""

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
    """Write the folder of a made-up experiment with every key of the format, ready for simulation and diagnosis.

    Two pads on the surface push in one after another, as far as the body finds equilibrium; ten markers and one inner
    target are tracked. The tables hold what the believed model predicts on the mesh as it is, with noise. The user is
    to replace all of this by actual pads and measurements.

    The folder must be new or empty; the mesh file stays where it is. `fixed` is a rule that selects the held nodes (a
    plane, a ball, or the name of a node set). By default they are the mesh's node set ``fixed``, or the lowest nodes
    along z if there is none. `progress` is called with the number of frames solved and that of all frames. Cost: about
    ten solves on the mesh.

    Raises ConvergenceError if no equilibrium is found under the made-up pushes, FormatError or MeshError if the mesh
    cannot be read or the rule selects no node, OutputError if the folder is a file, is not empty, or cannot be written.
    """
    target = place("folder", folder, error=OutputError)
    check_folder_target(target)
    _check_empty(target)
    mesh_file = place("mesh", mesh, error=FormatError)
    body = read_mesh(mesh_file)
    rule, guessed = _held(body, fixed)
    rig = MadeUpRig.on(body, nodes_by_rule(body, rule))
    tables = _tables(target.absolute().name, rule, rig)
    with atomic_folder(target) as draft:
        experiment, answers = _simulated(draft, tables, mesh_file, rig, threads, progress)
        for table, histories in simulated_tables(experiment, with_noise(experiment, answers, seed=seed)):
            write_histories(draft / table.file, table, histories)
        model = Simulated("plain", "tet4", tables_sha256(draft, mesh_file))
        _write_text(draft, _text(tables, path_from(target, mesh_file), model))
        files = tuple(file for file in TABLES if (draft / file).exists())
        _check_empty(target)
    return Begun(files, guessed)


def _check_empty(target: Path) -> None:
    if not target.is_dir():
        return
    remove_stale_drafts(target)
    held = [entry.name for entry in target.iterdir() if not entry.name.startswith(DRAFT_PREFIX)]
    if held:
        message = f"the folder of a new experiment must be new or empty; {target} holds {held[0]}"
        raise OutputError(message, where=str(target))


def _simulated(
    draft: Path,
    tables: _Tables,
    mesh_file: Path,
    rig: MadeUpRig,
    threads: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[Experiment, dict[str, CaseSimulation]]:
    """Return the experiment and its simulated load cases, with pushes halved until all cases have an equilibrium."""
    _write_text(draft, _text(tables, mesh_file.absolute().as_posix(), None))
    for halved in range(_HALVINGS + 1):
        _write_frames(draft, rig, 0.5**halved)
        experiment = read_experiment(draft, measured=False)
        try:
            answers = simulate_plain(experiment, threads=threads, progress=progress)
        except ConvergenceError:
            continue
        if not any(answer.failed for answer in answers.values()):
            return experiment, answers
    message = (
        f"a push of {0.5**_HALVINGS * np.linalg.norm(rig.pushes, axis=1).max():.2g} mm must have an equilibrium on "
        "this mesh, and none was found: its elements may be too flat, or too little of it is held"
    )
    raise ConvergenceError(message, where=str(mesh_file))


def _write_text(folder: Path, text: str) -> None:
    try:
        (folder / "experiment.toml").write_text(text, encoding="utf-8")
    except UnicodeEncodeError as error:
        message = "names of the folder and the mesh must be text that UTF-8 can hold"
        raise OutputError(message, where=str(folder)) from error


def _held(body: Mesh, fixed: NodeRule | None) -> tuple[str | dict[str, Any], tuple[str, ...]]:
    """Return the rule that selects the held nodes, for the experiment file, and sentences on what was guessed."""
    if fixed is not None:
        return rule_for_file(fixed, "fixed"), ()
    if "fixed" in body.node_sets and len(body.node_sets["fixed"]):
        return "fixed", ()
    low, high = body.nodes[:, 2].min(), body.nodes[:, 2].max()
    tolerance = _BASE_SHARE * (high - low)
    plane = {"plane": [0.0, 0.0, 1.0, float(low)], "tolerance_mm": float(tolerance)}
    guessed = f"the mesh has no node set 'fixed': all nodes within {tolerance:.3g} mm of its lowest along z are held"
    return plane, (guessed,)


def _tables(name: str, rule: Any, rig: MadeUpRig) -> _Tables:
    pads = [
        {
            "name": f"pad_{i + 1}",
            "nodes": {"centre_mm": centre.tolist(), "radius_mm": float(radius)},
            "kind": "displacement",
        }
        for i, (centre, radius) in enumerate(zip(rig.centres, rig.radii, strict=True))
    ]
    markers = {f"M{i + 1}": spot.tolist() for i, spot in enumerate(rig.markers)}
    return [
        (Top, {"name": name}),
        (MeshKeys, {}),
        (MaterialKeys, {"law": "neo-hookean", "young_kpa": [10.0, 3.0], "poisson": 0.45}),
        (GravityKeys, None),
        (BoundaryKeys, {"name": "support", "nodes": rule, "kind": "fixed"}),
        *((ActuatorKeys, pad) for pad in pads),
        (MarkersKeys, {"std_mm": 0.1, "rest_case": "rest", "reference": markers}),
        (ForcesKeys, {"std_mN": 5.0}),
        (TargetKeys, {"name": "target", "reference": rig.target.tolist()}),
    ]


def _text(tables: _Tables, mesh: str, simulated: Simulated | None) -> str:
    head = [
        "An experiment to begin with, made by `tissuereg new`: replace pads, markers and tables by your own.",
        "Every key is here; those behind # may be left out. Lengths mm, forces mN, stresses kPa, times s.",
        "The tables hold predictions of the model below for two made-up pushes, with noise. Once they hold what you",
        "measured, delete [simulated] at the end.",
    ]
    filled = [(each, {"file": mesh} if each is MeshKeys else values) for each, values in tables]
    last = [] if simulated is None else [(SimulatedKeys, asdict(simulated))]
    return commented_toml(head, [*filled, *last])


def _write_frames(folder: Path, rig: MadeUpRig, share: float) -> None:
    """Write the motion of the pads, `share` times the largest pushes, and the frames in which markers are tracked."""
    times = np.arange(len(_STROKE), dtype=np.float64)
    pushes: dict[str, tuple[FloatArray, dict[str, FloatArray]]] = {
        f"push_{i + 1}": (10.0 * (i + 1) + times, {f"pad_{i + 1}": share * _STROKE[:, None] * push + 0.0})
        for i, push in enumerate(rig.pushes)
    }
    write_histories(folder / ACTUATORS_CSV.file, ACTUATORS_CSV, pushes)
    frames = {"rest": np.arange(float(_REST_FRAMES)), **{case: given for case, (given, _) in pushes.items()}}
    names = [f"M{i + 1}" for i in range(len(rig.markers))]
    unseen: dict[str, tuple[FloatArray, dict[str, FloatArray]]] = {
        case: (given, {name: np.full((len(given), 3), np.nan) for name in names}) for case, given in frames.items()
    }
    write_histories(folder / MARKERS_CSV.file, MARKERS_CSV, unseen)
