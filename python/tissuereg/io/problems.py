"""Static problems (a body with material and load) and displacement fields in .npz files: reading and writing."""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.provenance import reads
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError, MaterialError
from tissuereg.io.fields import Archive, open_npz, write_npz
from tissuereg.io.meshes import mesh_arrays, mesh_from_archive


@dataclass(frozen=True, eq=False)
class Problem:
    """A static problem: a body with its material and load, and perhaps another solver's answer to compare with.

    `mesh`: reference shape, mm, whose node set ``fixed`` is held; `material`: neo-Hookean, Young's modulus in kPa;
    `load`: nodal forces in mN, and body force and prescribed displacement if the file has them; `reference` (n_nodes,
    3): another solver's displacement in mm; None if the file has none.
    """

    mesh: Mesh
    material: Material
    load: Load
    reference: FloatArray | None = None


def read_problem(path: str | os.PathLike[str]) -> Problem:
    """Read a static problem, a body with its material and load, from one file.

    `path`: an .npz with ``nodes_mm (n, 3)``, ``tets (m, 4)``, ``fixed_nodes (f,)``, ``forces_mN (n, 3)``, ``young_kPa``
    and ``poisson`` (one for all, or one per tet); optional are ``body_force_mN_per_mm3 (3,)``, ``prescribed_mm (f, 3)``
    (displacements in the order of ``fixed_nodes``) and ``displacement_mm (n, 3)`` (a solution to compare with). The
    forces may be absent if one of the two other loads is there. Other arrays are ignored. Raises `FormatError` if the
    file is no such archive; the message names the array; `MeshError` or `MaterialError` if mesh or moduli are out of
    their range.
    """
    with open_npz(path) as archive:
        mesh = mesh_from_archive(archive)
        _ = archive.indices("fixed_nodes", None), mesh.fixed_nodes
        n_nodes = mesh.n_nodes
        forces = _floats_if_there(archive, "forces_mN", n_nodes, 3)
        body_force = _floats_if_there(archive, "body_force_mN_per_mm3", 3)
        prescribed = _prescribed(archive)
        if forces is None and body_force is None and prescribed is None:
            archive.raw("forces_mN")
        material = _material(archive, mesh.n_tets)
        reference = _floats_if_there(archive, "displacement_mm", n_nodes, 3)
    return Problem(mesh, material, Load(forces, body_force, prescribed), reference)


def write_solution(path: str | os.PathLike[str], problem: Problem, displacement: Any, reactions: Any) -> None:
    """Write the solution of a static problem as an .npz file, whole or not at all.

    `path`: the file, which `read_simulation` and ``tissuereg register --simulation`` read; `problem`: the problem that
    was solved; `displacement` (n_nodes, 3): displacement of the nodes, mm; `reactions` (n_fixed, 3): force on the body
    at every held node in mN, in the order of ``fixed_nodes`` of the problem's mesh.
    """
    write_npz(
        path,
        {
            "displacement_mm": np.asarray(displacement, dtype=np.float64),
            "reactions_mN": np.asarray(reactions, dtype=np.float64),
            "fixed_nodes": problem.mesh.fixed_nodes,
        },
    )


@reads
def read_simulation(path: str | os.PathLike[str], n_nodes: int | None = None) -> FloatArray:
    """Read the displacement (n_nodes, 3), in mm, that a simulation gave the nodes of a mesh.

    `path`: an .npz with ``displacement_mm (n, 3)``; `n_nodes`: number of nodes that it must have; None for any. Raises
    `FormatError` if there is no such array, or it has another shape or a value that is not finite.
    """
    with open_npz(path) as archive:
        return archive.floats("displacement_mm", n_nodes, 3)


@reads
def read_variants(path: str | os.PathLike[str], n_nodes: int | None = None) -> FloatArray:
    """Read k displacement fields of one moment, (k, n_nodes, 3) in mm, simulated with different uncertain parameters.

    `path`: an .npz with ``displacement_mm (k, n, 3)``; `n_nodes`: number of nodes that it must have; None for any.
    Raises `FormatError` if there is no such array, or it has another shape or a value that is not finite.
    """
    with open_npz(path) as archive:
        return archive.floats("displacement_mm", None, n_nodes, 3)


def read_simulations(path: str | os.PathLike[str], n_nodes: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Read a simulation's displacement fields at k moments: their times (k,) in s and the fields (k, n_nodes, 3) in mm.

    `path`: an .npz with ``times_s (k,)``, ascending, and ``displacement_mm (k, n, 3)``; `n_nodes`: number of nodes that
    it must have; None for any. Raises `FormatError` if an array is missing, has another shape or a value that is not
    finite, or there are not two ascending times.
    """
    with open_npz(path) as archive:
        return times_and_fields(archive, n_nodes, least=2)


def times_and_fields(archive: Archive, n_nodes: int | None, *, least: int) -> tuple[FloatArray, FloatArray]:
    """Return times (k,), s, of which there are `least` or more, and fields (k, n_nodes, 3), mm, of an open .npz."""
    times = archive.floats("times_s", None)
    fields = archive.floats("displacement_mm", len(times), n_nodes, 3)
    if len(times) < least or not (np.diff(times) > 0.0).all():
        message = f"array 'times_s' in {archive.path} must hold {least} or more ascending times, got {len(times)}"
        raise FormatError(message, where=f"{archive.path}:times_s")
    return times, fields


def write_simulations(path: str | os.PathLike[str], times: Any, fields: Any, mesh: Mesh | None = None) -> None:
    """Write displacement fields at several moments as an .npz file that `read_simulations` reads, whole or not at all.

    `path`: the file; `times` (k,): time of each moment, s; `fields` (k, n_nodes, 3): displacement of the nodes, mm;
    `mesh`: the body, which is written too if it is given.
    """
    moments = {"times_s": np.asarray(times, np.float64), "displacement_mm": np.asarray(fields, np.float64)}
    write_npz(path, moments if mesh is None else {**mesh_arrays(mesh), **moments})


def _floats_if_there(archive: Archive, name: str, *shape: int) -> FloatArray | None:
    return archive.floats(name, *shape) if name in archive else None


def _prescribed(archive: Archive) -> FloatArray | None:
    """Return the prescribed displacements (n_fixed, 3), mm, of the fixed nodes in ascending order, or None.

    None means that the file has none. Raises `FormatError` if it has them but repeats a fixed node.
    """
    if "prescribed_mm" not in archive:
        return None
    given = archive.indices("fixed_nodes", None)
    order = np.argsort(given, kind="stable")
    if np.any(np.diff(given[order]) == 0):
        message = f"array 'fixed_nodes' in {archive.path} must not repeat a node where 'prescribed_mm' is given"
        raise FormatError(message, where=f"{archive.path}:fixed_nodes")
    return archive.floats("prescribed_mm", len(given), 3)[order]


def _material(archive: Archive, n_tets: int) -> Material:
    values = {name: _one_or_each(archive, name, n_tets) for name in ("young_kPa", "poisson")}
    try:
        return Material(values["young_kPa"], values["poisson"])
    except MaterialError as error:
        error.args = (f"{archive.path}: {error}",)
        raise


def _one_or_each(archive: Archive, name: str, n_tets: int) -> FloatArray:
    array = archive.raw(name)
    shape = () if array.ndim == 0 else (1,) if array.shape == (1,) else (n_tets,)
    return archive.floats(name, *shape)
