"""Reading of surfaces of triangles: .stl, .ply, .obj, .off; .vtp by pyvista; .vtu, .vtk, .msh by meshio.

The unit is given, or stated in the file (``unit: mm`` or ``UNITS=mm`` in the header of an .stl or in a comment of a
.ply, .obj or .off), or else mm. So is the patient frame (``SPACE=RAS``), or else it is unknown. A body's largest extent
must lie between 5 and 2,000 mm: anything else is refused, with the unit that would make it a body.
"""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arguments import place as path_of
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError, MissingPackageError, ShapeError, UnitError
from tissuereg.io.bounds import FILES, existing_file, mesh_file
from tissuereg.io.foreign import MESHIO_MODULES, meshio_content, reading
from tissuereg.io.notes import agreed_frame, frame_in, unit_in
from tissuereg.io.obj import read_obj
from tissuereg.io.off import read_off
from tissuereg.io.ply import read_ply
from tissuereg.io.polygons import cut
from tissuereg.io.stl import read_stl

#: What may be given as a surface: a file, or vertices (n, 3) and triangles (m, 3).
SurfaceInput = str | os.PathLike[str] | tuple[Any, Any] | Triangles

#: Vertices (n, 3) as they stand in a file, triangles (m, 3), and notes that may state unit and frame.
SurfaceContent = tuple[FloatArray, IntArray, list[str]]

#: Millimetres in each unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

_WHAT = "a surface"
_UNIT_NAMES = {"mm": "millimetres", "cm": "centimetres", "m": "metres"}
_FLAT_CELLS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
_IGNORED_CELLS = {"vertex", "line", "line3"}


def read_triangles(surface: SurfaceInput, unit: str | None = None, *, frame: str | None = None) -> Triangles:
    """Read a surface of triangles and return it in mm.

    `surface`: a .stl, .ply, .obj, .off, .vtp, .vtu, .vtk or .msh file; or vertices (n, 3) and triangles (m, 3); `unit`
    {"mm", "cm", "m"}: unit of the coordinates; None for that stated in the file, or else mm; `frame` {"LPS", "RAS"}:
    their patient frame; None for that stated in the file, if one is. The coordinates are not turned. Faces of more
    corners are cut into triangles; the corners of an .stl, which repeats them for every triangle, are joined where they
    are equal to the last bit. Raises `FormatError` if the file is missing, spoilt, of another kind, or holds no faces;
    if `unit` or `frame` is none of these, or the file states another frame; `MeshError` or `ShapeError` if coordinates
    are not finite, or indices out of range; `UnitError` if the largest extent is not that of an organ, 5 to 2,000 mm;
    `MissingPackageError` if a .vtp is given and pyvista is not installed.

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
    return _in_mm(surface, unit or "mm", agreed_frame(surface.frame, frame, "`surface`"), "`surface`")


def _of_file(file: Path, unit: str | None, frame: str | None) -> Triangles:
    try:
        vertices, triangles, notes = _content(file)
        if not len(triangles):
            message = f"{file} must hold the faces of a surface; it holds {len(vertices)} points and no face"
            raise FormatError(message, where=str(file))
        found, stated = Triangles(vertices, triangles), frame_in(notes)
    except (MeshError, ShapeError, FormatError) as error:
        if str(file) not in str(error):
            error.args = (f"{file}: {error}",)
        raise
    return _in_mm(found, _unit_of(file, unit, notes), agreed_frame(stated, frame, str(file)), str(file))


def _content(file: Path) -> SurfaceContent:
    reader = SURFACE_READERS.get(file.suffix.lower())
    if reader is None:
        message = f"a surface file must be one of {', '.join(SURFACE_READERS)}, got '{file.name}'"
        raise FormatError(message, where=str(file))
    return reader(mesh_file(file, "surface"))


def _by_pyvista(file: Path) -> SurfaceContent:
    try:
        import pyvista
    except ImportError as error:
        message = f"a .vtp is read by pyvista, which is not installed; pip install 'tissuereg[mesh]' brings it; {file}"
        raise MissingPackageError(message, where=str(file)) from error
    with reading(file, _WHAT):
        read: Any = pyvista.read(str(file)).triangulate()
        vertices, faces = np.asarray(read.points, np.float64), np.asarray(read.faces, np.int64)
    return vertices, faces.reshape(-1, 4)[:, 1:], []


def _by_meshio(file: Path) -> SurfaceContent:
    content = meshio_content(file, _WHAT)
    with reading(file, _WHAT):
        vertices = np.asarray(content.points, np.float64)
    kinds = sorted({str(block.type) for block in content.cells} - _IGNORED_CELLS)
    if not kinds or any(kind not in _FLAT_CELLS for kind in kinds):
        found = ", ".join(kinds) or "none"
        message = f"{file} must be a surface of triangles or quads; it holds cells of kind {found}"
        raise FormatError(message, where=str(file))
    faces = [np.asarray(b.data, np.int64)[:, : _FLAT_CELLS[b.type]] for b in content.cells if b.type in _FLAT_CELLS]
    return vertices, np.concatenate([cut(vertices, block) for block in faces]), []


def _unit_of(file: Path, given: str | None, notes: list[str]) -> str:
    stated = unit_in(notes)
    if given is not None and stated is not None and given != stated:
        text = f"{file} states that it is in {_UNIT_NAMES[stated]}; it is read in {_UNIT_NAMES[given]}, as given"
        warnings.warn(text, stacklevel=5)
    return given or stated or "mm"


def _in_mm(surface: Triangles, unit: str, frame: str | None, place: str) -> Triangles:
    extent, (least, most) = surface.extent, (FILES.least_extent_mm, FILES.most_extent_mm)
    if not least <= extent * UNITS_MM[unit] <= most:
        message = (
            f"extent {extent:.3g}: {_advice(extent)}. The largest extent of a body must lie between {least:g} and "
            f"{most:g} mm; {place}, read in {unit}, has {extent * UNITS_MM[unit]:.4g} mm"
        )
        raise UnitError(message, where=place.strip("`"))
    return Triangles(surface.vertices * UNITS_MM[unit], surface.triangles, frame)


def _advice(extent: float) -> str:
    least, most = (FILES.least_extent_mm, FILES.most_extent_mm)
    likely = [unit for unit, factor in UNITS_MM.items() if least <= extent * factor <= most]
    if not likely:
        return f"neither of {', '.join(UNITS_MM)} makes this a body; convert the file"
    # Millimetres are the commonest; otherwise the unit that brings the extent closest to a usual body's.
    best = min(likely, key=lambda unit: (unit != "mm", abs(np.log(extent * UNITS_MM[unit] / FILES.typical_extent_mm))))
    return f'looks like {_UNIT_NAMES[best]}; say --unit {best} (unit="{best}" in Python)'


#: Reader by the ending of a file's name, in lower case.
SURFACE_READERS: dict[str, Callable[[Path], SurfaceContent]] = {
    ".stl": read_stl,
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    ".vtp": _by_pyvista,
    **dict.fromkeys(MESHIO_MODULES, _by_meshio),
}
