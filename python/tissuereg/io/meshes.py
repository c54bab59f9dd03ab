"""Reading and writing of tetrahedral meshes: .vtu, .vtk and .msh through meshio, .npz directly.

Node sets come from 0/1 point data of any name, from named sets or physical groups of cells, and in an .npz from integer
arrays ``<name>_nodes``.
"""

import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import IntArray, float_array
from tissuereg.body.mesh import PATIENT_FRAMES, Mesh
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import existing_file, mesh_file
from tissuereg.io.fields import Archive, open_npz, write_npz
from tissuereg.io.foreign import MESHIO_MODULES, hushed, meshio_content
from tissuereg.io.node_rules import NodeRule, nodes_by_rule
from tissuereg.io.notes import agreed_frame
from tissuereg.io.surfaces import SURFACE_READERS

_SURFACE_CELLS = {"vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8", "quad9", "polygon"}
_TET_CELLS = {"tetra": 4, "tetra10": 10}


def read_mesh(path: str | os.PathLike[str], fixed: NodeRule | None = None, *, frame: str | None = None) -> Mesh:
    """Read a tetrahedral mesh with its node sets.

    Parameters
    ----------
    path : path-like
        A .vtu, .vtk or .msh file, or an .npz with ``nodes_mm (n, 3)``, ``tets (m, 4)``, integer arrays ``fixed_nodes``,
        ``<name>_nodes``, and ``frame``, a text. Lengths in mm.
    fixed : str or sequence of float, optional
        Rule that chooses the held nodes: ``"plane nx ny nz d [tol]"`` or those numbers (the nodes within `tol` mm of
        the plane ``n . x = d``, where n is the normal (nx, ny, nz) brought to length 1 and d its distance from the
        origin in mm), ``"ball x y z r"`` (the surface nodes within r mm of the point x, y, z), or the name of another
        node set of the file. By default the nodes of the file's set ``fixed`` are held.
    frame : {"LPS", "RAS"}, optional
        Patient frame of the coordinates, which the mesh then states; the coordinates themselves are not changed. By
        default that stated in the file, if one is.

    Returns
    -------
    Mesh
        The mesh in mm with corner nodes only; of ten-node tets the mid-edge nodes are dropped, with a warning.

    Raises
    ------
    FormatError
        If the file is missing, spoilt, of another kind, or holds no tetrahedra; if `fixed` is no such rule, `frame`
        none of the two, or not that which the file states.
    MeshError
        If the mesh itself cannot carry a simulation, or the plane or ball catches no node.
    """
    file = existing_file(path)
    reader = MESH_READERS.get(file.suffix.lower())
    if reader is None:
        raise _unknown_format(file)
    mesh = reader(file)
    if frame is not None:
        mesh = mesh.in_frame(agreed_frame(mesh.frame, frame, str(file)))
    return mesh if fixed is None else mesh.with_node_set("fixed", nodes_by_rule(mesh, fixed))


def mesh_from_archive(archive: Archive) -> Mesh:
    """Return the mesh that an open .npz file holds, with nodes in mm and its node sets.

    `archive`: the file, with ``nodes_mm`` (n, 3), ``tets`` (m, 4) and integer arrays ``<name>_nodes``; each of these
    becomes a node set with the name before ``_nodes``; ``frame``, if it is there, is the text LPS or RAS.
    """
    nodes = archive.floats("nodes_mm", None, 3, finite=False)  # `Mesh` names the node that is not
    tets = archive.indices("tets", None, 4)
    sets = {
        name.removesuffix("_nodes"): archive.indices(name, None)
        for name in archive.names
        if name == "fixed_nodes" or (name.endswith("_nodes") and _holds_indices(archive.raw(name)))
    }
    return _placed(archive.path, nodes, tets, sets).in_frame(_stated_frame(archive))


def mesh_arrays(mesh: Mesh) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an .npz that holds a mesh in mm: nodes, tets, node sets, and the frame that it states."""
    frame = {} if mesh.frame is None else {"frame": np.array(mesh.frame)}
    sets = {f"{name}_nodes": indices for name, indices in mesh.node_sets.items()}
    return {"nodes_mm": mesh.nodes, "tets": mesh.tets, **sets, **frame}


def write_mesh_npz(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Write a mesh in mm as an .npz that `read_mesh` reads, whole or not at all."""
    write_npz(path, mesh_arrays(mesh))


def _stated_frame(archive: Archive) -> str | None:
    if "frame" not in archive:
        return None
    stated = str(archive.raw("frame"))
    check_choice(f"frame of {archive.path}", stated, PATIENT_FRAMES, FormatError)
    return stated


def write_vtu(
    path: str | os.PathLike[str],
    mesh: Mesh,
    point_data: Mapping[str, Any] | None = None,
    *,
    says: str = "",
    places: Any = None,
) -> None:
    """Write a mesh with values at its nodes as a .vtu file, whole or not at all.

    `path`: the file; its name should end in .vtu; `mesh`: nodes in mm; its node sets are written as 0/1 point data, so
    that `read_mesh` finds them; `point_data`: values at the nodes by name, which should end in the unit, each
    (n_nodes,) or (n_nodes, 3); `says`: a note for viewers about the whole file, in words joined by underscores, written
    as the name of an array of field data; `places` (n_nodes, 3): coordinates in mm to write in place of the mesh's own,
    for which tets may be inside out. Raises `ShapeError` if an array does not have one row per node.
    """
    import meshio

    points = mesh.nodes if places is None else float_array("places", places, (mesh.n_nodes, 3))

    values: dict[str, npt.NDArray[Any]] = {}
    for name, indices in mesh.node_sets.items():
        flags = np.zeros(mesh.n_nodes, dtype=np.int8)
        flags[indices] = 1
        values[name] = flags
    for name, array in (point_data or {}).items():
        numbers = np.asarray(array)
        if numbers.shape not in ((mesh.n_nodes,), (mesh.n_nodes, 3)):
            message = f"`{name}` must have shape ({mesh.n_nodes},) or ({mesh.n_nodes}, 3), got {numbers.shape}"
            raise ShapeError(message, where=name)
        values[name] = numbers if numbers.dtype.kind in "iu" else float_array(name, numbers, numbers.shape)
    content = meshio.Mesh(points.copy(), [("tetra", mesh.tets.copy())], point_data=values)
    with atomic_file(path) as temporary, hushed():
        meshio.vtu.write(temporary, content)
        if says:
            _add_field_data(temporary, says)


def _add_field_data(file: Path, name: str) -> None:
    """Add an array of field data called `name`, with a single 1, to a .vtu file.

    It is added as text, since meshio writes no such array, and cannot read a file with one that holds text.
    """
    array = (
        f'<FieldData><DataArray type="Int8" Name="{name}" NumberOfTuples="1" format="ascii">1</DataArray></FieldData>'
    )
    grid = b"<UnstructuredGrid>"
    file.write_bytes(file.read_bytes().replace(grid, grid + array.encode("ascii"), 1))


def _holds_indices(array: npt.NDArray[Any]) -> bool:
    return array.ndim == 1 and array.dtype.kind in "iu"


def _from_npz(file: Path) -> Mesh:
    with open_npz(file) as archive:
        return mesh_from_archive(archive)


def _from_meshio(file: Path) -> Mesh:
    content = meshio_content(mesh_file(file, "mesh"), "a mesh")
    _refuse_other_cells(file, [block.type for block in content.cells], np.asarray(content.points))
    corners = [_corners(block) for block in content.cells if block.type in _TET_CELLS]
    tets = np.concatenate(corners).astype(np.int64)
    nodes = np.asarray(content.points)
    if tets.size == 0 or tets.min() < 0 or tets.max() >= len(nodes):
        return _placed(file, nodes, tets, {})  # which raises the error
    used = np.unique(tets)
    sets = _node_sets(file, content, len(nodes))
    if len(used) < len(nodes):
        _warn_of_dropped(file, len(nodes) - len(used), any(block.type == "tetra10" for block in content.cells))
        new_from_old = np.full(len(nodes), -1, dtype=np.int64)
        new_from_old[used] = np.arange(len(used))
        nodes, tets = nodes[used], new_from_old[tets]
        sets = {name: kept[kept >= 0] for name, kept in ((name, new_from_old[old]) for name, old in sets.items())}
    return _placed(file, nodes, tets, sets)


def _refuse_other_cells(file: Path, kinds: list[str], points: npt.NDArray[Any]) -> None:
    others = sorted({kind for kind in kinds if kind not in _TET_CELLS and kind not in _SURFACE_CELLS})
    if others:
        message = f"{file} must be made of tetrahedra; it also holds cells of kind {', '.join(others)}"
        raise FormatError(message, where=str(file))
    if not any(kind in _TET_CELLS for kind in kinds):
        found = ", ".join(sorted(set(kinds))) or "no cells"
        flat = len(points) == 0 or np.ptp(points, axis=0).min() == 0
        advice = "It is flat: a mesh of a body is needed" if flat else _how_to_fill(file)
        message = f"{file} must hold tetrahedra; it holds {found} only. {advice}"
        raise FormatError(message, where=str(file))


def _node_sets(file: Path, content: Any, n_nodes: int) -> dict[str, IntArray]:
    sets = {str(name): np.asarray(nodes, dtype=np.int64) for name, nodes in content.point_sets.items()}
    sets |= _sets_of_cells(content)
    for name, values in content.point_data.items():
        flags = np.asarray(values).reshape(len(values), -1)
        if flags.shape == (n_nodes, 1) and flags.dtype.kind in "biuf" and np.isin(flags, (0, 1)).all():
            sets[str(name)] = np.flatnonzero(flags[:, 0]).astype(np.int64)
        elif name == "fixed":
            message = f"point data 'fixed' in {file} must be one 0 or 1 per node, got other values"
            raise FormatError(message, where=f"{file}:fixed")
    return sets


def _sets_of_cells(content: Any) -> dict[str, IntArray]:
    """Return the node indices, sorted int64 (n,), of each named set of cells or Gmsh physical group, by its name.

    `content`: the file as a `meshio.Mesh`.
    """
    found: dict[str, list[npt.NDArray[Any]]] = {}
    for name, rows in content.cell_sets.items():
        if not str(name).startswith("gmsh:"):
            pairs = [pair for pair in zip(content.cells, rows, strict=True) if pair[1] is not None]
            found.setdefault(str(name), []).extend(_corners(block)[chosen].ravel() for block, chosen in pairs)
    tags = content.cell_data.get("gmsh:physical", [])
    for name, (tag, dimension) in _physical_groups(content):
        for block, block_tags in zip(content.cells, tags, strict=False):
            if block.dim == dimension:
                found.setdefault(name, []).append(_corners(block)[np.asarray(block_tags) == tag].ravel())
    return {name: np.unique(np.concatenate(parts)).astype(np.int64) for name, parts in found.items() if parts}


def _physical_groups(content: Any) -> list[tuple[str, tuple[int, int]]]:
    pairs = ((str(name), np.asarray(value).ravel()) for name, value in content.field_data.items())
    return [(name, (int(value[0]), int(value[1]))) for name, value in pairs if value.size == 2]


def _corners(block: Any) -> npt.NDArray[Any]:
    data = np.asarray(block.data)
    return data[:, :4] if block.type in _TET_CELLS else data


def _warn_of_dropped(file: Path, n_dropped: int, second_order: bool) -> None:
    what = "mid-edge nodes of the ten-node tetrahedra" if second_order else "nodes that belong to no tetrahedron"
    warnings.warn(f"{file}: {n_dropped} {what} were dropped; the corner nodes keep their order", stacklevel=4)


def _placed(file: Path | str, nodes: Any, tets: Any, sets: Mapping[str, Any]) -> Mesh:
    """Return the mesh of nodes (n, 3) in mm, tets (m, 4) and node sets by name; errors name the file that held them."""
    try:
        return Mesh(nodes, tets, sets)
    except (MeshError, ShapeError) as error:
        error.args = (f"{file}: {error}",)
        raise


def _unknown_format(file: Path) -> FormatError:
    if file.suffix.lower() in SURFACE_READERS:
        message = f"a mesh must be made of tetrahedra; {file} holds a surface only. {_how_to_fill(file)}"
    else:
        known = ", ".join(MESH_READERS)
        message = f"a mesh file must be one of {known}, got '{file.name}'"
    return FormatError(message, where=str(file))


def _how_to_fill(file: Path) -> str:
    return (
        f"Fill the surface with tetrahedra first: tissuereg mesh {file} --size MM --out BODY.vtu "
        "(by pytetwild: pip install 'tissuereg[mesh]')"
    )


#: Reader by the ending of a file's name, in lower case: a mesh in mm with its node sets.
MESH_READERS: dict[str, Callable[[Path], Mesh]] = {**dict.fromkeys(MESHIO_MODULES, _from_meshio), ".npz": _from_npz}
