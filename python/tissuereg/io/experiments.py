"""Experiment folders: ``experiment.toml``, a mesh and the tables of what was measured."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.effects import Effect, check_effects, effect_from_table
from tissuereg.errors import ExperimentError, MaterialError, MeshError
from tissuereg.experiment import Actuator, Boundary, Case, Experiment, Gravity, Simulated
from tissuereg.io.cases import Histories, assemble_cases, read_histories
from tissuereg.io.meshes import read_mesh
from tissuereg.io.node_rules import nodes_near_plane, surface_nodes_in_ball
from tissuereg.io.toml import Table, experiment_file, read_toml
from tissuereg.material import GRAVITY_MM_PER_S2, SHAPE_KEYS, VOLUMETRIC, Material
from tissuereg.mesh import Mesh

#: Words of ``[simulated]``.
MODELS, ELEMENTS = ("fine", "plain"), ("tet4", "tet4-averaged", "tet10")

_CONTROL_TABLES = {"displacement": ("actuators.csv", "mm"), "force": ("forces_applied.csv", "mN")}


def read_experiment(path: str | os.PathLike[str]) -> Experiment:
    """Read an experiment folder.

    Parameters
    ----------
    path : path-like
        The folder, or the experiment file in it (``experiment.toml`` unless named).

    Returns
    -------
    Experiment
        Beliefs, mesh with its node sets, and all cases.

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
    tables = (file.parent / top.text("tables")) if "tables" in top else file.parent
    name = top.text("name", file.absolute().parent.name or "experiment")
    mesh_file, mesh, surface_std, surface_length = _mesh(top)
    material, young_std, poisson_std = _material(top)
    gravity = _gravity(top)
    boundaries = tuple(_boundary(table, mesh) for table in top.tables("boundary"))
    actuators = tuple(_actuator(table, mesh) for table in top.tables("actuator"))
    mesh = _with_patches(top, mesh, boundaries, actuators)
    targets = _targets(top)
    measured = _measured(top, tables, actuators, targets)
    effects = top.tables("effect")
    simulated = _simulated(top)
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
        marker_names=measured.marker_names,
        marker_reference=measured.marker_reference,
        marker_std=measured.marker_std,
        targets=targets,
        cases=measured.cases,
        force_std=measured.force_std,
        rest_case=measured.rest_case,
        trial_share=measured.trial_share,
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
    """Say whether a path means an experiment: a folder, or a TOML file that speaks of markers or boundaries.

    Parameters
    ----------
    path : path-like
        Folder or file.

    Returns
    -------
    bool
        False for data-set recipes and everything else.
    """
    place = Path(path)
    if place.is_dir() or place.suffix.lower() != ".toml":
        return place.is_dir()
    top = read_toml(place)
    return "markers" in top or "boundary" in top or top.get("kind") == "material-test"


def is_material_test(path: str | os.PathLike[str]) -> bool:
    """Say whether a path means a material test: a folder or file whose ``kind`` says so.

    Parameters
    ----------
    path : path-like
        Folder or file.

    Returns
    -------
    bool
        False where there is no such file: reading it says why.
    """
    place = Path(path)
    file = place / "experiment.toml" if place.is_dir() else place
    return file.is_file() and file.suffix.lower() == ".toml" and read_toml(file).get("kind") == "material-test"


@dataclass(frozen=True, eq=False)
class _Measured:
    marker_names: tuple[str, ...]
    marker_reference: FloatArray
    marker_std: float
    rest_case: str | None
    trial_share: float
    force_std: float | None
    cases: dict[str, Case]


def _refuse_other_kinds(top: Table) -> None:
    kind = top.text("kind", "rig")
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
    """Return file and mesh, and how far its surface is off, over which length."""
    table = _needed_table(top, "mesh")
    file = table.file.parent / table.text("file")
    std = _positive(table, "surface_std_mm")
    length = _positive(table, "surface_length_mm")
    table.finish()
    return file, read_mesh(file), std or 0.0, length


def _positive(table: Table, key: str) -> float | None:
    return table.number(key, positive=True) if key in table else None


def _material(top: Table) -> tuple[Material, float | None, float | None]:
    table = _needed_table(top, "material")
    law = table.text("law", "neo-hookean")
    young, young_std = table.belief("young_kpa")
    poisson, poisson_std = table.belief("poisson")
    density = table.number("density_g_per_cm3", 1.0, positive=True)
    volumetric = table.text("volumetric", "log", among=VOLUMETRIC)
    shape = {key: table.need(key) for key in SHAPE_KEYS.get(law, ())}
    try:
        material = Material(young, poisson, law, density, shape, volumetric)
    except MaterialError as error:
        table.refuse(str(error))
    table.finish()
    return material, young_std, poisson_std


def _gravity(top: Table) -> Gravity | None:
    table = top.table("gravity")
    if table is None:
        return None
    direction = table.numbers("direction", 3)
    if not np.any(direction):
        table.refuse("`direction` must have a length", direction.tolist())
    strength = table.number("g_mm_per_s2", GRAVITY_MM_PER_S2, positive=True)
    gravity = Gravity(direction, table.flag("in_reference"), strength)
    table.finish()
    return gravity


def _simulated(top: Table) -> Simulated | None:
    table = top.table("simulated")
    if table is None:
        return None
    said = Simulated(table.text("model", among=MODELS), table.text("element", among=ELEMENTS))
    table.finish()
    return said


def _boundary(table: Table, mesh: Mesh) -> Boundary:
    name = table.text("name")
    kind = table.text("kind", "fixed", among=("fixed",))
    nodes = _selected_nodes(table, mesh)
    edge_std = _positive(table, "edge_std_mm")
    table.finish()
    return Boundary(name, nodes, kind, table.get("nodes"), edge_std)


def _actuator(table: Table, mesh: Mesh) -> Actuator:
    name = table.text("name")
    if name == "fixed":
        table.refuse("`name` must not be 'fixed', which means the held nodes")
    kind = table.text("kind", among=tuple(_CONTROL_TABLES))
    contact = table.text("contact", "bonded", among=("bonded",))
    nodes = _selected_nodes(table, mesh)
    edge_std = _positive(table, "edge_std_mm")
    table.finish()
    return Actuator(name, nodes, kind, contact, table.get("nodes"), edge_std)


def _selected_nodes(table: Table, mesh: Mesh) -> IntArray:
    """Return the nodes of a set, near a plane, or of the surface within a sphere."""
    if isinstance(table.need("nodes"), str):
        try:
            return mesh.node_set(table.text("nodes"))
        except MeshError as error:
            table.refuse(str(error))
    rule = table.table("nodes")
    assert rule is not None  # `need` has seen it
    if "plane" in rule:
        nodes = _near_plane(rule, mesh)
    elif "centre_mm" in rule:
        nodes = _within_sphere(rule, mesh)
    else:
        table.refuse("`nodes` must be a node set, { plane, tolerance_mm } or { centre_mm, radius_mm }", rule.rest())
    rule.finish()
    return nodes


def _near_plane(rule: Table, mesh: Mesh) -> IntArray:
    plane = rule.numbers("plane", 4)
    tolerance = rule.number("tolerance_mm", 0.1)
    if not np.any(plane[:3]):
        rule.refuse("the normal of `plane` must have a length", plane.tolist())
    try:
        return nodes_near_plane(mesh, plane[:3].tolist(), float(plane[3]), tolerance)
    except MeshError as error:
        rule.refuse(str(error))


def _within_sphere(rule: Table, mesh: Mesh) -> IntArray:
    centre, radius = rule.numbers("centre_mm", 3), rule.number("radius_mm", positive=True)
    try:
        return surface_nodes_in_ball(mesh, centre, radius)
    except MeshError as error:
        rule.refuse(str(error))


def _targets(top: Table) -> dict[str, FloatArray]:
    targets: dict[str, FloatArray] = {}
    for table in top.tables("target"):
        name = table.text("name")
        if name in targets:
            table.refuse("`name` must be given to one target only", name)
        targets[name] = table.numbers("reference", 3)
        table.finish()
    return targets


def _with_patches(top: Table, mesh: Mesh, boundaries: Sequence[Boundary], actuators: Sequence[Actuator]) -> Mesh:
    """Return the mesh with the patches as node sets, and ``fixed`` as all that is held."""
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


def _measured(top: Table, folder: Path, actuators: Sequence[Actuator], targets: dict[str, FloatArray]) -> _Measured:
    table = _needed_table(top, "markers")
    std = table.number("std_mm", positive=True)
    rest_case = table.text("rest_case") if "rest_case" in table else None
    trial_share = _positive(table, "trial_share") or 0.0
    reference, reference_time = _marker_reference(table)
    table.finish()
    markers = read_histories(folder / "markers.csv", "marker", "mm", None if reference is None else reference)
    if reference is None:
        reference = _first_places(table, markers, reference_time)
    force_std, forces = _measured_forces(top, folder, actuators)
    inner: Histories = {}
    if (folder / "targets.csv").exists():
        inner = read_histories(folder / "targets.csv", "target", "mm", targets)
    cases = assemble_cases(markers, tuple(reference), actuators, _controls(folder, actuators), forces, inner)
    if rest_case is not None and rest_case not in cases:
        table.refuse(f"`rest_case` must be one of the cases {', '.join(cases)}", rest_case)
    places = np.array(list(reference.values()))
    return _Measured(tuple(reference), places, std, rest_case, trial_share, force_std, cases)


def _marker_reference(table: Table) -> tuple[dict[str, FloatArray] | None, float]:
    """Return the markers' places by name, or None and the time of the frame that has them."""
    places = table.table("reference")
    if places is not None and "reference_time_s" not in places:
        names = list(places.rest())
        if not names:
            places.refuse("at least one marker must have a place")
        return {name: places.numbers(name, 3) for name in names}, 0.0
    holder = table if places is None else places
    time = holder.number("reference_time_s")
    if places is not None:
        places.finish()
    return None, time


def _first_places(table: Table, markers: Histories, time: float) -> dict[str, FloatArray]:
    """Return where each marker was seen at the reference time."""
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


def _measured_forces(top: Table, folder: Path, actuators: Sequence[Actuator]) -> tuple[float | None, Histories]:
    table, path = top.table("forces"), folder / "forces.csv"
    if table is None:
        if path.exists():
            top.refuse("[forces] with std_mN must be given, since there is a forces.csv")
        return None, {}
    std = table.number("std_mN", positive=True)
    table.finish()
    return std, read_histories(path, "actuator", "mN", [actuator.name for actuator in actuators])


def _controls(folder: Path, actuators: Sequence[Actuator]) -> dict[str, Histories]:
    found: dict[str, Histories] = {}
    for kind, (file, unit) in _CONTROL_TABLES.items():
        names = [actuator.name for actuator in actuators if actuator.kind == kind]
        path = folder / file
        if names or path.exists():
            found[kind] = read_histories(path, "actuator", unit, names)
    return found


def _needed_table(top: Table, key: str) -> Table:
    table = top.table(key)
    if table is None:
        message = f"a table [{key}] must be given in {top.file}"
        raise ExperimentError(message, where=f"{top.file}:[{key}]")
    return table
