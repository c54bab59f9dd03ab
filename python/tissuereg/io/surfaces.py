"""Reading of surfaces of triangles: .stl, .ply, .obj, .off by trimesh, others as the meshes of other programs.

The unit is given, or stated in the head of the file (``unit: mm`` or ``UNITS=mm`` in the header of an .stl or in a
comment of a .ply, .obj or .off), or else mm. A body's largest extent must lie between 5 and 2,000 mm: anything else is
refused, with the unit that would make it a body.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arguments import place as path_of
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.provenance import warn
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.bounds import FILES, existing_file, mesh_file
from tissuereg.io.extents import UNIT_NAMES, UNITS_MM, check_extent
from tissuereg.io.foreign import GRID_READERS, read_grid, reading
from tissuereg.io.grid import FLAT_KINDS, unit_in

#: What may be given as a surface: a file, or vertices (n, 3) and triangles (m, 3).
SurfaceInput = str | os.PathLike[str] | tuple[Any, Any] | Triangles

_WHAT = "a surface"
_TRIMESH_SUFFIXES = (".stl", ".ply", ".obj", ".off")
_STL_HEAD_BYTES = 80


def read_triangles(surface: SurfaceInput, unit: str | None = None) -> Triangles:
    """Read a surface of triangles and return it in mm.

    `surface`: a .stl, .ply, .obj, .off, .vtp, .vtu, .vtk, .msh or .xdmf file; or vertices (n, 3) and triangles (m, 3);
    `unit` {"mm", "cm", "m"}: unit of the coordinates. If it is None, it is that stated in the file's head, or else mm.
    Four-cornered faces are cut in two. The corners of an .stl, which repeats them for every triangle, are joined where
    they are equal to the last bit. Raises `FormatError` if the file is missing, spoilt, of another kind, or holds no
    faces; or if `unit` is no such unit; `MeshError` or `ShapeError` if coordinates are not finite, or indices out of
    range; `UnitError` if the largest extent is not that of an organ, 5 to 2,000 mm. Outside 20 to 600 mm in a unit that
    nobody states there is a `UnitWarning`.

    Examples
    --------
    >>> box = ([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> read_triangles(box, "m").extent
    100.0
    >>> read_triangles(box)
    Traceback (most recent call last):
    ...
    tissuereg.errors.UnitError: extent 0.1: looks like metres; say --unit m (unit="m" in Python). The largest extent
    of a body must lie between 5 and 2000 mm; `surface`, read in mm, has 0.1 mm
    """
    if unit is not None:
        check_choice("unit", unit, UNITS_MM, FormatError)
    if isinstance(surface, Triangles):
        return _in_mm(surface, unit, "`surface`")
    if isinstance(surface, tuple | list):
        if len(surface) != 2:
            message = f"`surface` must be a file, or vertices (n, 3) and triangles (m, 3), got {len(surface)} things"
            raise ShapeError(message, where="surface")
        return _in_mm(Triangles(*surface), unit, "`surface`")
    file = existing_file(path_of("surface", surface, error=FormatError))
    try:
        found = Triangles(*_content(file))
    except (MeshError, ShapeError) as error:
        error.args = (f"{file}: {error}",)
        raise
    return _in_mm(found, _unit_of(file, unit), str(file))


def _content(file: Path) -> tuple[FloatArray, IntArray]:
    reader = SURFACE_READERS.get(file.suffix.lower())
    if reader is None:
        message = f"a surface file must be one of {', '.join(SURFACE_READERS)}, got '{file.name}'"
        raise FormatError(message, where=str(file))
    return reader(mesh_file(file, "surface"))


def _of_stl(file: Path) -> tuple[FloatArray, IntArray]:
    vertices, triangles = _by_trimesh(file)
    # Coordinates that are not finite are refused by the caller; joining them would take long.
    return _joined(vertices, triangles) if np.isfinite(vertices).all() else (vertices, triangles)


def _by_trimesh(file: Path) -> tuple[FloatArray, IntArray]:
    import trimesh

    with reading(file, _WHAT):
        read: Any = trimesh.load_mesh(str(file), process=False)
        vertices, triangles = np.asarray(read.vertices, np.float64), np.asarray(getattr(read, "faces", ()), np.int64)
    if not triangles.size:
        message = f"{file} must hold the faces of a surface; it holds {len(vertices)} points and no face"
        raise FormatError(message, where=str(file))
    return vertices, triangles


def _by_grid(file: Path) -> tuple[FloatArray, IntArray]:
    grid = read_grid(file, "surface")
    solid = [kind for kind in grid.kinds if kind not in FLAT_KINDS]
    triangles = grid.triangles()
    if solid or not len(triangles):
        message = (
            f"{file} must be a surface of triangles or quads; it holds cells of kind {', '.join(grid.kinds) or 'none'}"
        )
        raise FormatError(message, where=str(file))
    return grid.points, triangles


def _joined(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Merge equal vertices; return the vertices (k, 3), ordered by first occurrence, and the triangles (m, 3)."""
    _, first, of_vertex = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[of_vertex.reshape(-1)[triangles]]


def _unit_of(file: Path, given: str | None) -> str | None:
    stated = _noted_unit(file)
    if given is not None and stated is not None and given != stated:
        text = f"{file} states that it is in {UNIT_NAMES[stated]}; it is read in {UNIT_NAMES[given]}, as given"
        warn(text)
    return given or stated


def _noted_unit(file: Path) -> str | None:
    """Return the unit, ``mm``, ``cm`` or ``m``, that is stated in the head of a surface file; None if none is."""
    suffix = file.suffix.lower()
    if suffix not in _TRIMESH_SUFFIXES:
        return None
    with file.open("rb") as stream:
        head = stream.read(_STL_HEAD_BYTES if suffix == ".stl" else FILES.head_bytes).decode("latin-1")
    if suffix == ".stl":
        head = head.splitlines()[0] if head.startswith("solid") and head.strip() else head
    elif suffix == ".ply":
        head = "\n".join(line for line in head.partition("end_header")[0].splitlines() if line.startswith("comment"))
    else:
        head = "\n".join(line for line in head.splitlines() if line.startswith("#"))
    return unit_in([head])


def _in_mm(surface: Triangles, unit: str | None, place: str) -> Triangles:
    used = unit or "mm"
    check_extent(surface.extent, used, place, 'say --unit {unit} (unit="{unit}" in Python)', sure=unit is not None)
    return surface if used == "mm" else Triangles(surface.vertices * UNITS_MM[used], surface.triangles)


#: Reader by the ending of a file's name, in lower case: vertices (n, 3) as they stand and triangles (m, 3).
SURFACE_READERS: dict[str, Callable[[Path], tuple[FloatArray, IntArray]]] = {
    ".stl": _of_stl,
    ".ply": _by_trimesh,
    ".obj": _by_trimesh,
    ".off": _by_trimesh,
    **dict.fromkeys((".vtp", *GRID_READERS), _by_grid),
}
