"""Reading of surfaces of triangles: .stl, .ply, .obj, .off, and those in mesh files of other programs.

The unit is given, or stated in the file (``unit: mm`` or ``UNITS=mm`` in the header of an .stl or in a comment of a
.ply, .obj or .off), or else mm. So is the patient frame (``SPACE=RAS``), or else it is unknown. A body's largest extent
must lie between 5 and 2,000 mm: anything else is refused, with the unit that would make it a body.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tissuereg._base.arguments import check_choice
from tissuereg._base.arguments import place as path_of
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Frame, Unit
from tissuereg._base.provenance import warn
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.bounds import existing_file, mesh_file
from tissuereg.io.extents import UNIT_NAMES, UNITS_MM, check_extent
from tissuereg.io.foreign import GRID_READERS, read_grid
from tissuereg.io.grid import FLAT_KINDS
from tissuereg.io.notes import agreed_frame, frame_in, unit_in
from tissuereg.io.obj import read_obj
from tissuereg.io.off import read_off
from tissuereg.io.ply import read_ply
from tissuereg.io.stl import read_stl

#: What may be given as a surface: a file, or vertices (n, 3) and triangles (m, 3).
SurfaceInput = str | os.PathLike[str] | tuple[Any, Any] | Triangles

#: Vertices (n, 3) as they stand in a file, triangles (m, 3), and notes that may state unit and frame.
SurfaceContent = tuple[FloatArray, IntArray, list[str]]


def read_triangles(surface: SurfaceInput, unit: Unit | None = None, *, frame: Frame | None = None) -> Triangles:
    """Read a surface of triangles and return it in mm.

    `surface`: a .stl, .ply, .obj, .off, .vtp, .vtu, .vtk, .msh or .xdmf file; or vertices (n, 3) and triangles (m, 3);
    `unit` {"mm", "cm", "m"}: unit of the coordinates; None for that stated in the file, or else mm; `frame` {"LPS",
    "RAS"}: their patient frame; None for that stated in the file, if one is. The coordinates are not turned. Faces of
    more corners are cut into triangles; the corners of an .stl, which repeats them for every triangle, are joined where
    they are equal to the last bit. Raises `FormatError` if the file is missing, spoilt, of another kind, or holds no
    faces; if `unit` or `frame` is none of these, or the file states another frame; `MeshError` or `ShapeError` if
    coordinates are not finite, or indices out of range; `UnitError` if the largest extent is not that of an organ, 5 to
    2,000 mm. Outside 20 to 600 mm in a unit that nobody states there is a `UnitWarning`.

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
    if not isinstance(surface, Triangles | tuple | list):
        return _of_file(existing_file(path_of("surface", surface, error=FormatError)), unit, frame)
    if not isinstance(surface, Triangles):
        if len(surface) != 2:
            message = f"`surface` must be a file, or vertices (n, 3) and triangles (m, 3), got {len(surface)} things"
            raise ShapeError(message, where="surface")
        surface = Triangles(*surface)
    return _in_mm(surface, unit, agreed_frame(surface.frame, frame, "`surface`"), "`surface`")


def _of_file(file: Path, unit: Unit | None, frame: Frame | None) -> Triangles:
    try:
        vertices, triangles, notes = _content(file)
        if not len(triangles):
            message = f"{file} must hold the faces of a surface; it holds {len(vertices)} points and no face"
            raise FormatError(message, where=str(file))
        found, stated = Triangles(vertices, triangles), frame_in(notes)
        used = _unit_of(file, unit, notes)
    except (MeshError, ShapeError, FormatError) as error:
        if str(file) not in str(error):
            error.args = (f"{file}: {error}",)
        raise
    return _in_mm(found, used, agreed_frame(stated, frame, str(file)), str(file))


def _content(file: Path) -> SurfaceContent:
    reader = SURFACE_READERS.get(file.suffix.lower())
    if reader is None:
        message = f"a surface file must be one of {', '.join(SURFACE_READERS)}, got '{file.name}'"
        raise FormatError(message, where=str(file))
    return reader(mesh_file(file, "surface"))


def _of_grid(file: Path) -> SurfaceContent:
    grid = read_grid(file, "surface")
    if any(kind not in FLAT_KINDS for kind in grid.kinds) or not grid.kinds:
        found = ", ".join(grid.kinds) or "none"
        message = f"{file} must be a surface of triangles or quads; it holds cells of kind {found}"
        raise FormatError(message, where=str(file))
    return grid.points, grid.triangles(), grid.notes


def _unit_of(file: Path, given: Unit | None, notes: list[str]) -> Unit | None:
    stated = unit_in(notes)
    if given is not None and stated is not None and given != stated:
        text = f"{file} states that it is in {UNIT_NAMES[stated]}; it is read in {UNIT_NAMES[given]}, as given"
        warn(text)
    return given or stated


def _in_mm(surface: Triangles, unit: Unit | None, frame: Frame | None, place: str) -> Triangles:
    used = unit or "mm"
    check_extent(surface.extent, used, place, 'say --unit {unit} (unit="{unit}" in Python)', sure=unit is not None)
    return Triangles(surface.vertices * UNITS_MM[used], surface.triangles, frame)


#: Reader by the ending of a file's name, in lower case.
SURFACE_READERS: dict[str, Callable[[Path], SurfaceContent]] = {
    ".stl": read_stl,
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    **dict.fromkeys((".vtp", *GRID_READERS), _of_grid),
}
