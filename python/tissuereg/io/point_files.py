"""Markers and targets (inner points) from files of points with labels, such as those of 3D Slicer."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Frame, Match
from tissuereg._base.provenance import warn
from tissuereg.body.markers import Markers
from tissuereg.errors import FormatError, MarkerError
from tissuereg.io.control_points import is_control_point_table, read_control_points
from tissuereg.io.fcsv import read_fcsv
from tissuereg.io.matching import Labels, partners
from tissuereg.io.mrk_json import read_mrk_json
from tissuereg.io.points import NamedPoints

#: Reader by the ending of a file's name, in lower case; of two that fit, the first counts.
POINT_READERS: dict[str, Callable[[str | os.PathLike[str]], NamedPoints]] = {
    ".mrk.json": read_mrk_json,
    ".json": read_mrk_json,
    ".fcsv": read_fcsv,
}


def is_point_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a file holds labelled points: by the ending of its name, or the header of a table of Slicer."""
    return _ending(path) is not None or is_control_point_table(path)


def read_points(path: str | os.PathLike[str]) -> NamedPoints:
    """Read the named points in a file of 3D Slicer, with their places in mm in the file's frame.

    `path`: a file whose name ends in ``.mrk.json``, ``.json`` or ``.fcsv``, or a table of control points. Labels may be
    empty or stand twice. Raises `FormatError` if the file is missing, spoilt or of another kind; the message names the
    place in it.
    """
    ending = _ending(path)
    if ending is not None:
        return POINT_READERS[ending](path)
    if is_control_point_table(path):
        return read_control_points(path)
    message = f"a file of points must be one of {', '.join(POINT_READERS)} or a table of control points, got {path}"
    raise FormatError(message, where=str(path))


def _ending(path: str | os.PathLike[str]) -> str | None:
    return next((ending for ending in POINT_READERS if str(path).lower().endswith(ending)), None)


def targets_of(path: str | os.PathLike[str], frame: Frame | None) -> dict[str, FloatArray]:
    """Read the targets (inner points of a body) in a file of points: the place (3,) of each in mm, by its label.

    `path`: a file of 3D Slicer; `frame`: ``"LPS"`` or ``"RAS"``, the frame of the result; None for that of the file.
    Result: in file order. Raises `FormatError` if the file cannot be read, or a target has no place.
    """
    points = read_points(path).labelled()
    if not points.defined.all():
        name = points.names[int(np.argmin(points.defined))]
        message = f"every target must have a place; that of '{name}' in {points.file} is not defined"
        raise FormatError(message, where=f"{points.file}: {name}")
    return dict(zip(points.names, points.places_in(frame), strict=True))


def places_of(path: str | os.PathLike[str], frame: Frame | None) -> FloatArray:
    """Read the places (n, 3), in mm, of the points in a file of points, whatever their labels, in file order.

    `path`: a file of 3D Slicer; `frame`: ``"LPS"`` or ``"RAS"``, the frame of the result; None for that of the file.
    Points that are not defined are left out. Raises `FormatError` if the file cannot be read, or defines no point.
    """
    points = read_points(path)
    if not points.defined.any():
        message = f"{points.file} must hold at least one point with a place; none is defined"
        raise FormatError(message, where=str(points.file))
    return points.places_in(frame)[points.defined]


def markers_of(
    reference: str | os.PathLike[str],
    measured: str | os.PathLike[str] | None,
    std: float,
    frame: Frame | None,
    match: Match = "label",
) -> Markers:
    """Read markers from two files of points: their places on the undeformed body, and their measured places.

    `reference`, `measured`: files of points of the two, which may have frames and units of their own; `std`: standard
    deviation of a measured coordinate, mm; `frame`: ``"LPS"`` or ``"RAS"``, the frame of the result; None for that of
    `reference`; `match`: which points belong together, as of `partners`. Result: in the order of `reference`. A marker
    that `measured` lacks, or does not define, counts as not measured; one that `reference` does not define is left out,
    with a warning. Raises `FormatError` if there are not two such files, one cannot be read, or `measured` has a point
    without a partner in `reference`; `MarkerError` if `std` is not positive.
    """
    files = {"reference": reference, "measured": measured}
    for role, path in files.items():
        if path is None or not is_point_file(path):
            other = next(file for file in files.values() if file is not None and is_point_file(file))
            found = "missing" if path is None else f"{path}, which is no file of points"
            message = (
                "markers of a file of points must come in two files, where they sit and, as `measured`, where seen; "
                f"with {other} the {role} one is {found} "
                f"({', '.join(POINT_READERS)}, or a table with the columns label and r,a,s or l,p,s)"
            )
            raise FormatError(message, where=str(other if path is None else path))
    sit, seen = read_points(reference).labelled(), read_points(measured or "")
    if match == "label":
        seen = seen.labelled()
    rows = partners(Labels(str(sit.file), sit.names), Labels(str(seen.file), seen.names, seen.where), match)
    where = frame or sit.frame
    names = [sit.names[row] for row in rows]
    return _markers(sit, dict(zip(names, seen.places_in(where), strict=True)), std, where)


def reference_of(path: str | os.PathLike[str], std: float, frame: Frame | None) -> Markers:
    """Read markers, none of them measured yet, from a file of points with their places on the undeformed body.

    `path`: a file of points; `std`: standard deviation of a coordinate that will be measured, mm; `frame`: ``"LPS"`` or
    ``"RAS"``, the frame of the result; None for that of the file. A marker without a place is left out, with a warning.
    Raises `FormatError` if the file cannot be read; `MarkerError` if `std` is not positive.
    """
    sit = read_points(path).labelled()
    return _markers(sit, {}, std, frame or sit.frame)


def _markers(sit: NamedPoints, seen: dict[str, FloatArray], std: float, frame: Frame) -> Markers:
    """Return the markers whose place on the undeformed body is known, with their measured places.

    `sit`: places on the undeformed body by label, mm; `seen`: measured places (3,), mm, by label; `std`: standard
    deviation of a measured coordinate, mm; `frame`: LPS or RAS, the frame of `seen` and of the result.
    """
    names = [name for name, known in zip(sit.names, sit.defined, strict=True) if known]
    if len(names) < len(sit.names):
        lost = ", ".join(name for name in sit.names if name not in names)
        warn(f"{sit.file}: {lost} left out, where it sits is not defined")
    places = [seen.get(name, np.full(3, np.nan)) for name in names]
    try:
        return Markers(sit.places_in(frame)[sit.defined], np.reshape(places, (-1, 3)), std, names)
    except MarkerError as error:
        error.args = (f"{sit.file}: {error}",)
        raise


def frame_of_files(paths: list[str | Path]) -> tuple[Frame, str] | None:
    """Return the frame (``LPS`` or ``RAS``) and the name of the first file of labelled points among `paths`.

    Result: None if none of the files is one of labelled points.
    """
    first = next((path for path in paths if is_point_file(path)), None)
    return None if first is None else (read_points(first).frame, str(first))
