"""Reading of surfaces of triangles: .stl, .ply, .obj, .off by trimesh, .vtp by pyvista, .vtu, .vtk, .msh by meshio.

The unit is given, or stated in the head of the file (``unit: mm`` or ``UNITS=mm`` in the header of an .stl or in a
comment of a .ply, .obj or .off), or else mm. A body's largest extent must lie between 5 and 2,000 mm: anything else is
refused, with the unit that would make it a body.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arguments import place as path_of
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.provenance import warn
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError, MissingPackageError, ShapeError, UnitError
from tissuereg.io.bounds import FILES, existing_file, mesh_file
from tissuereg.io.foreign import MESHIO_MODULES, meshio_content, reading

#: What may be given as a surface: a file, or vertices (n, 3) and triangles (m, 3).
SurfaceInput = str | os.PathLike[str] | tuple[Any, Any] | Triangles

#: Millimetres in each unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

_WHAT = "a surface"
_UNIT_NAMES = {"mm": "millimetres", "cm": "centimetres", "m": "metres"}
_TRIMESH_SUFFIXES = (".stl", ".ply", ".obj", ".off")
_FLAT_CELLS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
_IGNORED_CELLS = {"vertex", "line", "line3"}
_STL_HEAD_BYTES = 80
_UNIT_NOTE = re.compile(r"\bunits?\b\s*[:= ]\s*(milli|centi)?(mm|cm|m|met(?:er|re)s?)\b", re.IGNORECASE)


def read_triangles(surface: SurfaceInput, unit: str | None = None) -> Triangles:
    """Read a surface of triangles and return it in mm.

    `surface`: a .stl, .ply, .obj, .off, .vtp, .vtu, .vtk or .msh file; or vertices (n, 3) and triangles (m, 3); `unit`
    {"mm", "cm", "m"}: unit of the coordinates. If it is None, the unit is that stated in the file's head, or else mm.
    Four-cornered faces are cut in two. The corners of an .stl, which repeats them for every triangle, are joined where
    they are equal to the last bit. Raises `FormatError` if the file is missing, spoilt, of another kind, or holds no
    faces; or if `unit` is no such unit; `MeshError` or `ShapeError` if coordinates are not finite, or indices out of
    range; `UnitError` if the largest extent is not that of an organ, 5 to 2,000 mm; `MissingPackageError` if a .vtp is
    given and pyvista is not installed.

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
        return _in_mm(surface, unit or "mm", "`surface`")
    if isinstance(surface, tuple | list):
        if len(surface) != 2:
            message = f"`surface` must be a file, or vertices (n, 3) and triangles (m, 3), got {len(surface)} things"
            raise ShapeError(message, where="surface")
        return _in_mm(Triangles(*surface), unit or "mm", "`surface`")
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


def _by_pyvista(file: Path) -> tuple[FloatArray, IntArray]:
    try:
        import pyvista
    except ImportError as error:
        message = f"a .vtp is read by pyvista, which is not installed; pip install 'tissuereg[mesh]' brings it; {file}"
        raise MissingPackageError(message, where=str(file)) from error
    with reading(file, _WHAT):
        read: Any = pyvista.read(str(file)).triangulate()
        vertices, faces = np.asarray(read.points, np.float64), np.asarray(read.faces, np.int64)
    if not faces.size:
        message = f"{file} must hold the faces of a surface; it holds {len(vertices)} points and no face"
        raise FormatError(message, where=str(file))
    return vertices, faces.reshape(-1, 4)[:, 1:]


def _by_meshio(file: Path) -> tuple[FloatArray, IntArray]:
    content = meshio_content(file, _WHAT)
    with reading(file, _WHAT):
        vertices = np.asarray(content.points, np.float64)
    kinds = sorted({str(block.type) for block in content.cells} - _IGNORED_CELLS)
    if not kinds or any(kind not in _FLAT_CELLS for kind in kinds):
        found = ", ".join(kinds) or "none"
        message = f"{file} must be a surface of triangles or quads; it holds cells of kind {found}"
        raise FormatError(message, where=str(file))
    faces = [np.asarray(b.data, np.int64)[:, : _FLAT_CELLS[b.type]] for b in content.cells if b.type in _FLAT_CELLS]
    return vertices, np.concatenate([_cut(block) for block in faces])


def _cut(faces: IntArray) -> IntArray:
    """Return faces, node indices (n, 3) or (n, 4), as triangles (m, 3); four-cornered faces are cut in two."""
    return faces if faces.shape[1] == 3 else np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def _joined(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Merge equal vertices; return the vertices (k, 3), ordered by first occurrence, and the triangles (m, 3)."""
    _, first, of_vertex = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[of_vertex.reshape(-1)[triangles]]


def _unit_of(file: Path, given: str | None) -> str:
    stated = _noted_unit(file)
    if given is not None and stated is not None and given != stated:
        text = f"{file} states that it is in {_UNIT_NAMES[stated]}; it is read in {_UNIT_NAMES[given]}, as given"
        warn(text)
    return given or stated or "mm"


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
    note = _UNIT_NOTE.search(head)
    if note is None:
        return None
    prefix, word = (note[1] or "").lower(), note[2].lower()
    if word in ("mm", "cm"):
        return None if prefix else word
    return {"": "m", "milli": "mm", "centi": "cm"}[prefix]


def _in_mm(surface: Triangles, unit: str, place: str) -> Triangles:
    extent, (least, most) = surface.extent, (FILES.least_extent_mm, FILES.most_extent_mm)
    if not least <= extent * UNITS_MM[unit] <= most:
        message = (
            f"extent {extent:.3g}: {_advice(extent)}. The largest extent of a body must lie between {least:g} and "
            f"{most:g} mm; {place}, read in {unit}, has {extent * UNITS_MM[unit]:.4g} mm"
        )
        raise UnitError(message, where=place.strip("`"))
    return surface if unit == "mm" else Triangles(surface.vertices * UNITS_MM[unit], surface.triangles)


def _advice(extent: float) -> str:
    least, most = (FILES.least_extent_mm, FILES.most_extent_mm)
    likely = [unit for unit, factor in UNITS_MM.items() if least <= extent * factor <= most]
    if not likely:
        return f"neither of {', '.join(UNITS_MM)} makes this a body; convert the file"
    # Millimetres are the commonest; otherwise the unit that brings the extent closest to a usual body's.
    best = min(likely, key=lambda unit: (unit != "mm", abs(np.log(extent * UNITS_MM[unit] / FILES.typical_extent_mm))))
    return f'looks like {_UNIT_NAMES[best]}; say --unit {best} (unit="{best}" in Python)'


#: Reader by the ending of a file's name, in lower case: vertices (n, 3) as they stand and triangles (m, 3).
SURFACE_READERS: dict[str, Callable[[Path], tuple[FloatArray, IntArray]]] = {
    ".stl": _of_stl,
    ".ply": _by_trimesh,
    ".obj": _by_trimesh,
    ".off": _by_trimesh,
    ".vtp": _by_pyvista,
    **dict.fromkeys(MESHIO_MODULES, _by_meshio),
}
