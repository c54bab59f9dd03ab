"""Reading of experiment folders: ``experiment.toml``, a mesh and the comma-separated tables of measurements."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import flag, real, reals
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.provenance import reads, warn
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ExperimentError, MeshError
from tissuereg.experiment.effects import Effect, check_effects, effect_from_table
from tissuereg.experiment.experiment import Actuator, BodyWeight, Boundary, Case, Experiment, Simulated
from tissuereg.io.cases import Histories, assemble_cases, read_histories
from tissuereg.io.experiment_keys import (
    CONTROL_TABLES,
    FORCES_CSV,
    MARKERS_CSV,
    TARGETS_CSV,
    ActuatorKeys,
    BoundaryKeys,
    ForcesKeys,
    GravityKeys,
    MarkersKeys,
    MeshKeys,
    SimulatedKeys,
    TargetKeys,
    folder_and_name,
    read_material,
)
from tissuereg.io.meshes import read_mesh
from tissuereg.io.node_rules import nodes_by_rule
from tissuereg.io.simulated import tables_sha256
from tissuereg.io.toml import Table, experiment_file, read_toml


@reads
def read_experiment(path: str | os.PathLike[str], *, measured: bool = True) -> Experiment:
    """Read the folder of an experiment on a body with supports, actuators and tracked markers (a rig).

    Parameters
    ----------
    path : path-like
        The folder, or the experiment file in it (``experiment.toml`` unless named).
    measured : bool
        Whether the experiment has been measured. If not, ``markers.csv`` and ``forces.csv`` may be missing: the cases
        are then those in which an actuator has rows.

    Returns
    -------
    Experiment
        The believed material, supports and noise, the mesh with its node sets, and all load cases with measurements.

    Raises
    ------
    ExperimentError
        If a key, node set, actuator, marker or target is unknown, a plane or sphere catches no node, a table
        contradicts another; file and line or table are named.
    FormatError
        If a file is missing or cannot be read.
    MeshError
        If the mesh cannot carry a simulation.
    """
    top = read_toml(experiment_file(path))
    file = top.file
    _refuse_other_kinds(top)
    tables, name = folder_and_name(top)
    mesh_file, mesh, surface_std, surface_length = _mesh(top)
    material, young_std, poisson_std = read_material(top)
    gravity = _gravity(top)
    boundaries = tuple(_boundary(table, mesh) for table in top.tables("boundary"))
    actuators = tuple(_actuator(table, mesh) for table in top.tables("actuator"))
    mesh = _with_patches(top, mesh, boundaries, actuators)
    _refuse_held_pads(top, mesh, actuators)
    targets = _targets(top)
    tabled = _tabled(top, tables, actuators, targets, flag("measured", measured, error=ExperimentError))
    effects = top.tables("effect")
    simulated = _simulated(top, tables, mesh_file)
    top.finish()
    experiment = Experiment(
        name=name,
        folder=tables,
        mesh_file=mesh_file,
        mesh=mesh,
        material=material,
        young_std=young_std,
        poisson_std=poisson_std,
        gravity=gravity,
        boundaries=boundaries,
        actuators=actuators,
        marker_names=tabled.marker_names,
        marker_reference=tabled.marker_reference,
        marker_std=tabled.marker_std,
        targets=targets,
        cases=tabled.cases,
        force_std=tabled.force_std,
        rest_case=tabled.rest_case,
        trial_share=tabled.trial_share,
        surface_std=surface_std,
        surface_length=surface_length,
        simulated=simulated,
        effects=tuple(_effect(table) for table in effects),
    )
    try:
        check_effects(experiment)
    except ExperimentError as error:
        message = f"{error} of {file}"
        raise ExperimentError(message, where=f"{file}:{error.where}") from error
    return experiment


def is_experiment(path: str | os.PathLike[str]) -> bool:
    """Return whether a path can be that of an experiment: any folder, or a TOML file with the keys of an experiment.

    Result: False for the recipe of a data set and everything else. Raises `FormatError` or `ExperimentError` if a path
    that ends in .toml cannot be read.
    """
    place = Path(path)
    if place.is_dir() or place.suffix.lower() != ".toml":
        return place.is_dir()
    top = read_toml(place)
    return "markers" in top or "boundary" in top or top.get("kind") == "material-test"


def is_material_test(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is that of a material test: its experiment file states ``kind = "material-test"``.

    `path`: the folder or the file. Result: False also where there is no such file; reading it then raises the error.
    """
    place = Path(path)
    file = place / "experiment.toml" if place.is_dir() else place
    return file.is_file() and file.suffix.lower() == ".toml" and read_toml(file).get("kind") == "material-test"


@dataclass(frozen=True, eq=False)
class _Tabled:
    marker_names: tuple[str, ...]
    marker_reference: FloatArray
    marker_std: float
    rest_case: str | None
    trial_share: float
    force_std: float | None
    cases: dict[str, Case]


def _refuse_other_kinds(top: Table) -> None:
    kind = top.get("kind", "rig")
    if kind != "rig":
        top.refuse(
            "an experiment must be a rig with mesh and markers; `read_material_experiment` reads material tests", kind
        )


def _effect(table: Table) -> Effect:
    try:
        return effect_from_table(table.rest())
    except ExperimentError as error:
        table.refuse(str(error))


def _mesh(top: Table) -> tuple[Path, Mesh, float, float | None]:
    """Return the mesh of an experiment: its file, the mesh itself, and the accuracy of its surface.

    `top`: content of ``experiment.toml``. The last two values are the standard deviation of the surface's place along
    the normal and the length over which this error is correlated (None if not stated), both in mm.
    """
    given = MeshKeys.alone(top)
    assert given is not None  # it is needed
    file = top.file.parent / given.file
    return file, read_mesh(file), given.surface_std_mm or 0.0, given.surface_length_mm


def _gravity(top: Table) -> BodyWeight | None:
    given = GravityKeys.alone(top)
    return None if given is None else BodyWeight(np.array(given.direction), given.in_reference, given.g_mm_per_s2)


def _simulated(top: Table, tables: Path, mesh_file: Path) -> Simulated | None:
    """Return what ``[simulated]`` states; None, with a warning, where it is about another mesh or other tables."""
    given = SimulatedKeys.alone(top)
    if given is None:
        return None
    if given.tables_sha256 is not None and given.tables_sha256 != tables_sha256(tables, mesh_file):
        text = (
            f"[simulated] of {top.file} is ignored: mesh and tables are not those that it is about, so that they count "
            "as measured; delete it"
        )
        warn(text)
        return None
    return Simulated(given.model, given.element, given.tables_sha256)


def _boundary(table: Table, mesh: Mesh) -> Boundary:
    given = BoundaryKeys.of(table)
    nodes = _selected_nodes(table, given.nodes, mesh)
    table.finish()
    return Boundary(given.name, nodes, given.kind, given.nodes, given.edge_std_mm)


def _actuator(table: Table, mesh: Mesh) -> Actuator:
    given = ActuatorKeys.of(table)
    if given.name == "fixed":
        table.refuse("`name` must not be 'fixed', which means the held nodes")
    nodes = _selected_nodes(table, given.nodes, mesh)
    table.finish()
    return Actuator(given.name, nodes, given.kind, given.contact, given.nodes, given.edge_std_mm)


def _selected_nodes(table: Table, rule: Any, mesh: Mesh) -> IntArray:
    """Return sorted indices (n,) of the nodes that a rule chooses: a node set, or nodes near a plane or in a ball."""
    try:
        return nodes_by_rule(mesh, rule, "nodes")
    except MeshError as error:
        table.refuse(str(error))


def _targets(top: Table) -> dict[str, FloatArray]:
    targets: dict[str, FloatArray] = {}
    for table in top.tables("target"):
        given = TargetKeys.of(table)
        if given.name in targets:
            table.refuse("`name` must be given to one target only", given.name)
        targets[given.name] = np.array(given.reference)
        table.finish()
    return targets


def _with_patches(top: Table, mesh: Mesh, boundaries: Sequence[Boundary], actuators: Sequence[Actuator]) -> Mesh:
    """Return the mesh with a node set for each boundary and actuator, and with all held nodes as the set ``fixed``."""
    patches: list[Boundary | Actuator] = [*boundaries, *actuators]
    names = [patch.name for patch in patches]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        top.refuse("every boundary and actuator must have a name of its own", ", ".join(repeated))
    sets: dict[str, Any] = {**mesh.node_sets, **{patch.name: patch.nodes for patch in patches}}
    if boundaries:
        sets["fixed"] = np.unique(np.concatenate([boundary.nodes for boundary in boundaries]))
    elif "fixed" not in sets:
        top.refuse("the body must be held: a [[boundary]], or a node set 'fixed' in the mesh, must be given")
    return Mesh(mesh.nodes, mesh.tets, sets)


def _refuse_held_pads(top: Table, mesh: Mesh, actuators: Sequence[Actuator]) -> None:
    for pad in actuators:
        if np.isin(pad.nodes, mesh.fixed_nodes).all():
            top.refuse(
                f"an actuator must have a node that no boundary holds; all {len(pad.nodes)} of '{pad.name}' are held"
            )


def _refuse_two_motions(top: Table, actuators: Sequence[Actuator], cases: Mapping[str, Case]) -> None:
    """Raise `ExperimentError` if another actuator moves all nodes of a displacement actuator in the same load case."""
    for case in cases.values():
        moving = [pad for pad in actuators if pad.name in case.displacements]
        for one in moving:
            for other in moving:
                if one is not other and np.isin(one.nodes, other.nodes).all():
                    top.refuse(
                        f"displacement actuators of one case must have nodes of their own; all {len(one.nodes)} of "
                        f"'{one.name}' are moved by '{other.name}' too in case '{case.name}'"
                    )


def _tabled(
    top: Table, folder: Path, actuators: Sequence[Actuator], targets: dict[str, FloatArray], measured: bool
) -> _Tabled:
    """Return the markers (names, reference places, noise) and the load cases of an experiment, read from its tables.

    `top`: content of ``experiment.toml``; `folder`: folder of the tables; `targets`: inner points by name, places (3,)
    in mm; `measured`: whether the experiment has been measured; if not, the tables of markers and forces may be absent.
    """
    table = MarkersKeys.found(top)
    assert table is not None  # it is needed
    given = MarkersKeys.of(table)
    reference, reference_time = _marker_reference(table, given)
    table.finish()
    path = folder / MARKERS_CSV.file
    markers: Histories = {}
    seen = measured or reference is None or path.exists()
    if seen:
        markers = read_histories(path, MARKERS_CSV, None if reference is None else reference)
    if reference is None:
        reference = _first_places(table, markers, reference_time)
    force_std, forces = _measured_forces(top, folder, actuators, measured)
    inner: Histories = {}
    if (folder / TARGETS_CSV.file).exists():
        inner = read_histories(folder / TARGETS_CSV.file, TARGETS_CSV, targets)
    cases = assemble_cases(markers, tuple(reference), actuators, _controls(folder, actuators), forces, inner)
    if not cases:
        top.refuse(f"there must be a case: rows in markers.csv, actuators.csv or forces_applied.csv of {folder}")
    _refuse_two_motions(top, actuators, cases)
    rest_case = given.rest_case if seen else None
    if rest_case is not None and rest_case not in cases:
        table.refuse(f"`rest_case` must be one of the cases {', '.join(cases)}", rest_case)
    places = np.array(list(reference.values()))
    return _Tabled(tuple(reference), places, given.std_mm, rest_case, given.trial_share or 0.0, force_std, cases)


def _marker_reference(table: Table, given: MarkersKeys) -> tuple[dict[str, FloatArray] | None, float]:
    """Return the reference places of the markers by name, (3,) in mm, and 0; or None and a time in s.

    The time is that of the frame in which the markers were measured on the undeformed body. `table`, `given`: the table
    ``[markers]`` of the experiment file and its checked keys.
    """
    places = table.table("reference")
    if places is not None and "reference_time_s" not in places:
        names = list(places.rest())
        if not names:
            places.refuse("at least one marker must have a place")
        if given.reference_time_s is not None:
            table.refuse("`reference_time_s` must be left out where `reference` lists the places")
        return {name: np.array(places.take(name, partial(reals, length=3))) for name in names}, 0.0
    time = (table if places is None else places).take("reference_time_s", real)
    if places is not None:
        places.finish()
    return None, time


def _first_places(table: Table, markers: Histories, time: float) -> dict[str, FloatArray]:
    """Return the measured place of each marker at the given time in s, by name, shape (3,), in mm.

    `table`: the table ``[markers]`` of the experiment file, for the message; `markers`: rows of markers.csv by case and
    name. Raises `ExperimentError` if a marker has no place at this time.
    """
    places: dict[str, FloatArray] = {}
    for histories in markers.values():
        for name, history in histories.items():
            for moment, values in zip(history.times, history.values, strict=True):
                if abs(moment - time) <= 1e-6 and np.isfinite(values).all():
                    places.setdefault(name, np.array(values))
    lost = sorted({name for histories in markers.values() for name in histories} - set(places))
    if lost:
        table.refuse(f"every marker must be seen at reference_time_s = {time:g}; not seen: {', '.join(lost)}")
    return places


def _measured_forces(
    top: Table, folder: Path, actuators: Sequence[Actuator], measured: bool
) -> tuple[float | None, Histories]:
    given, path = ForcesKeys.alone(top), folder / FORCES_CSV.file
    if given is None:
        if path.exists():
            top.refuse(f"[forces] with std_mN must be given, since there is a {path.name}")
        return None, {}
    names = [actuator.name for actuator in actuators]
    return given.std_mN, read_histories(path, FORCES_CSV, names) if measured or path.exists() else {}


def _controls(folder: Path, actuators: Sequence[Actuator]) -> dict[str, Histories]:
    found: dict[str, Histories] = {}
    for kind, table in CONTROL_TABLES.items():
        names = [actuator.name for actuator in actuators if actuator.kind == kind]
        path = folder / table.file
        if names or path.exists():
            found[kind] = read_histories(path, table, names)
    return found
