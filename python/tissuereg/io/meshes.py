"""Reading and writing of tetrahedral meshes: .vtu, .vtk, .msh and .xdmf of other programs, .npz of our own.

Node sets come from 0/1 point data of any name, from named sets or physical groups of cells, and in an .npz from integer
arrays ``<name>_nodes``. Frame and unit are those that a file states.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray, IntArray, float_array
from tissuereg._base.choices import COINCIDENT, FRAMES, Coincident, Frame
from tissuereg._base.provenance import reads
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import existing_file
from tissuereg.io.fields import Archive, open_npz, write_npz
from tissuereg.io.foreign import GRID_READERS, read_grid
from tissuereg.io.grid_meshes import how_to_fill, mesh_of_grid, named_errors, placed_mesh
from tissuereg.io.node_rules import NodeRule, nodes_by_rule
from tissuereg.io.notes import agreed_frame
from tissuereg.io.surfaces import SURFACE_READERS
from tissuereg.io.vtk_xml_out import vtu_bytes


@reads
def read_mesh(
    path: str | os.PathLike[str],
    fixed: NodeRule | None = None,
    *,
    frame: Frame | None = None,
    coincident: Coincident = "certain",
) -> Mesh:
    """Read a tetrahedral mesh with its node sets.

    Tets that are all left-handed are turned, with a warning.

    Parameters
    ----------
    path : path-like
        A .vtu, .vtk, .msh or .xdmf file, or an .npz with ``nodes_mm (n, 3)``, ``tets (m, 4)``, integer arrays
        ``fixed_nodes``, ``<name>_nodes``, and ``frame``, a text. Lengths in mm, or in the unit that the file states.
    fixed : str or sequence of float, optional
        Rule that chooses the held nodes: ``"plane nx ny nz d [tol]"`` or those numbers (the nodes within `tol` mm of
        the plane ``n . x = d``, where n is the normal (nx, ny, nz) brought to length 1 and d its distance from the
        origin in mm), ``"ball x y z r"`` (the surface nodes within r mm of the point x, y, z), ``"box x0 y0 z0 x1 y1
        z1"`` (those in a box), ``"near FILE r"`` (those within r mm of another surface), or the name of another node
        set of the file. By default the nodes of the file's set ``fixed`` are held.
    frame : {"LPS", "RAS"}, optional
        Patient frame of the coordinates, by default that which the file states; the coordinates themselves are not
        changed.
    coincident : {"certain", "join", "keep"}
        What becomes of nodes at one place that tets do not share: joined, with a warning, where that is certain (whole
        faces coincide node by node, or pieces of the file meet), all joined, or all kept apart.

    Returns
    -------
    Mesh
        The mesh in mm with corner nodes only; of ten-node tets the mid-edge nodes are dropped, with a warning.

    Raises
    ------
    FormatError
        If the file is missing, spoilt, of another kind, or holds no tetrahedra; if `fixed` is no such rule; or if
        `frame` is not the frame that the file states.
    MeshError
        If the mesh itself cannot carry a simulation, the rule catches no node, or `frame` or `coincident` is
        none of its words.
    UnitError
        If the largest extent of the body is outside 5 to 2000 mm; outside 20 to 600 mm there is a `UnitWarning`.
    """
    check_choice("coincident", coincident, COINCIDENT, MeshError)
    if frame is not None:
        check_choice("frame", frame, FRAMES, MeshError)
    file = existing_file(path)
    suffix = file.suffix.lower()
    if suffix not in MESH_READERS:
        raise _unknown_format(file)
    mesh = MESH_READERS[suffix](file, coincident)
    stated = agreed_frame(mesh.frame, frame, str(file))
    if stated != mesh.frame:
        mesh = mesh.in_frame(stated)
    return mesh if fixed is None else mesh.with_node_set("fixed", nodes_by_rule(mesh, fixed))


def mesh_from_archive(archive: Archive) -> Mesh:
    """Return the mesh that an open .npz file of this package holds, as it stands, with nodes in mm and its node sets.

    `archive`: the file, with ``nodes_mm`` (n, 3), ``tets`` (m, 4) and integer arrays ``<name>_nodes``; each of these
    becomes a node set with the name before ``_nodes``; ``frame``, if it is there, is the text LPS or RAS.
    """
    with named_errors(archive.path):
        return Mesh(*_of_archive(archive))


def _of_archive(archive: Archive) -> tuple[FloatArray, IntArray, dict[str, IntArray], Frame | None]:
    nodes = archive.floats("nodes_mm", None, 3, finite=False)  # `Mesh` names the node that is not
    tets = archive.indices("tets", None, 4)
    sets = {
        name.removesuffix("_nodes"): archive.indices(name, None)
        for name in archive.names
        if name == "fixed_nodes" or (name.endswith("_nodes") and _holds_indices(archive.raw(name)))
    }
    stated = str(archive.raw("frame")) if "frame" in archive else None
    frame = None if stated is None else check_choice(f"frame of {archive.path}", stated, FRAMES, FormatError)
    return nodes, tets, sets, frame


def mesh_arrays(mesh: Mesh) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an .npz that holds a mesh in mm: nodes, tets, node sets, and the frame that it states."""
    frame = {} if mesh.frame is None else {"frame": np.array(mesh.frame)}
    sets = {f"{name}_nodes": indices for name, indices in mesh.node_sets.items()}
    return {"nodes_mm": mesh.nodes, "tets": mesh.tets, **sets, **frame}


def write_mesh_npz(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Write a mesh in mm as an .npz that `read_mesh` reads, whole or not at all."""
    write_npz(path, mesh_arrays(mesh))


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
    that `read_mesh` finds them, its frame as 3D Slicer states it (field data ``SPACE``); `point_data`: values at the
    nodes by name, which should end in the unit, each (n_nodes,) or (n_nodes, 3); `says`: a note for viewers about the
    whole file, in words joined by underscores, written as the name of an array of field data; `places` (n_nodes, 3):
    coordinates in mm to write in place of the mesh's own, for which tets may be inside out. Raises `ShapeError` if an
    array does not have one row per node.
    """
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
    texts = {} if mesh.frame is None else {"SPACE": mesh.frame}
    content = vtu_bytes(points, mesh.tets, values, texts, (says,) if says else ())
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)


def _holds_indices(array: npt.NDArray[Any]) -> bool:
    return array.ndim == 1 and array.dtype.kind in "iu"


def _from_npz(file: Path, coincident: Coincident) -> Mesh:
    with open_npz(file) as archive:
        nodes, tets, sets, frame = _of_archive(archive)
        return placed_mesh(file, nodes, tets, sets, coincident, frame)[0]


def _from_grid(file: Path, coincident: Coincident) -> Mesh:
    return mesh_of_grid(file, read_grid(file, "mesh"), coincident)[0]


def _unknown_format(file: Path) -> FormatError:
    if file.suffix.lower() in SURFACE_READERS:
        message = f"a mesh must be made of tetrahedra; {file} holds a surface only. {how_to_fill(file)}"
    else:
        known = ", ".join(MESH_READERS)
        message = f"a mesh file must be one of {known}, got '{file.name}'"
    return FormatError(message, where=str(file))


#: Reader by the ending of a file's name, in lower case: a mesh in mm with its node sets and frame.
MESH_READERS: dict[str, Callable[[Path, Coincident], Mesh]] = {
    **dict.fromkeys(GRID_READERS, _from_grid),
    ".npz": _from_npz,
}
