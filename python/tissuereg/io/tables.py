"""Markers, targets and surface points as comma-separated tables in mm; readers also take point files of 3D Slicer."""

import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, place, real
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import FRAMES, Frame, Match
from tissuereg._base.provenance import reads
from tissuereg.body.markers import Markers
from tissuereg.errors import FormatError, MarkerError
from tissuereg.io.bounds import FILES
from tissuereg.io.csv import Row, read_table, write_table
from tissuereg.io.point_files import is_point_file, markers_of, places_of, read_points, reference_of, targets_of
from tissuereg.io.points import turned

_PLACE = ("x_mm", "y_mm", "z_mm")
_MOVED = ("moved_x_mm", "moved_y_mm", "moved_z_mm")
_STD = ("std_x_mm", "std_y_mm", "std_z_mm")


@reads
def read_markers(
    path: str | os.PathLike[str],
    std: float | None = None,
    *,
    measured: str | os.PathLike[str] | None = None,
    frame: Frame | None = None,
    table_frame: Frame | None = None,
    match: Match = "label",
) -> Markers:
    """Read the markers of one moment: their places on the undeformed body and their measured places.

    Parameters
    ----------
    path : path-like
        Table ``marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm]``: the name of a marker, its place on or
        off the undeformed surface, then the place where it was measured; empty (or ``nan``) if it was not measured.
        Columns ``std_x_mm,std_y_mm,std_z_mm`` may follow where the noise differs between axes; an empty cell takes the
        value of the marker's ``std_mm``, or of `std`. Or a point file of 3D Slicer (``.mrk.json``, ``.fcsv``, a table
        of control points) with the places on the undeformed body.
    std : float, optional
        Standard deviation in mm of a measured coordinate, for markers that state none themselves; 0.1 by default.
    measured : path-like, optional
        Only if `path` is a point file of 3D Slicer: point file with the measured places. A marker that is missing in
        it, or whose status is not ``defined``, counts as not measured.
    frame : {"LPS", "RAS"}, optional
        Patient frame of the mesh, into which the markers are converted. By default, markers of point files are in the
        frame of the file `path`, and a table's numbers are not converted.
    table_frame : {"LPS", "RAS"}, optional
        Patient frame of the numbers in a table, if it is not `frame`.
    match : {"label", "order", "number"}
        Which points of `path` and `measured` belong together: those of the same label, the first of each and so on, or
        those with the same last number in their labels (``F-3`` and ``F_1-3``).

    Returns
    -------
    Markers
        The markers in file order, in mm, including those that were not measured.

    Raises
    ------
    FormatError
        If a file cannot be read, or a marker stands in it twice; the message names the line. If `measured` does not go
        with `path`, or has a point without a partner in it; if `match` is given with a table, which joins by itself.
    MarkerError
        If a standard deviation is not positive, a frame none of the two, or `table_frame` given without `frame`.
    """
    _check_frames(frame, table_frame)
    path = place("path", path, error=FormatError)
    measured = None if measured is None else place("measured", measured, error=FormatError)
    usual = FILES.std_mm if std is None else std
    if is_point_file(path) or (measured is not None and is_point_file(measured)):
        return markers_of(path, measured, usual, frame, match)
    if measured is not None:
        message = (
            f"a table of markers holds where they were seen itself; {measured} must be left out with {path}, or both "
            "be files of points (a table of points has the columns label and r,a,s or l,p,s, which state its frame)"
        )
        raise FormatError(message, where=str(measured))
    if match != "label":
        message = f"a table of markers joins where they sit and were seen itself; `match` must be left out with {path}"
        raise FormatError(message, where=str(path))
    rows = read_table(path, ("marker", *_PLACE, *_MOVED), ("std_mm", *_STD), most_rows=FILES.table_points)
    names = _unique_names(rows, "marker")
    spread = [_own_std(row, usual) for row in rows]
    reference = np.array([row.numbers(_PLACE) for row in rows])
    moved = np.array([row.numbers(_MOVED, may_miss=True) for row in rows])
    try:
        return Markers(turned(reference, table_frame, frame), turned(moved, table_frame, frame), spread, names)
    except MarkerError as error:
        error.args = (f"{rows[0].file}: {error}",)
        raise


@reads
def read_reference(
    path: str | os.PathLike[str],
    std: float | None = None,
    *,
    frame: Frame | None = None,
    table_frame: Frame | None = None,
) -> Markers:
    """Read markers with their places on the undeformed body only; none of them counts as measured.

    `path`: table ``marker,x_mm,y_mm,z_mm[,std_mm]``; columns with measured places may be there and are ignored. Or a
    point file of 3D Slicer; `std`: standard deviation in mm of a coordinate to be measured,
    for markers that state none themselves; 0.1 for None; `frame` {"LPS", "RAS"}: patient frame of the mesh, into which
    the places are converted; None for no conversion; `table_frame` {"LPS", "RAS"}: frame of the numbers in a table, if
    it is not `frame`. Result: in file order. Raises `FormatError` if the file cannot be read, or a marker stands in it
    twice; the message names the line; `MarkerError` if a standard deviation is not positive, a frame none of the two,
    or `table_frame` given without `frame`.
    """
    _check_frames(frame, table_frame)
    usual = FILES.std_mm if std is None else std
    if is_point_file(path):
        return reference_of(path, usual, frame)
    rows = read_table(path, ("marker", *_PLACE), ("std_mm", *_STD, *_MOVED), most_rows=FILES.table_points)
    names = _unique_names(rows, "marker")
    places = turned(np.array([row.numbers(_PLACE) for row in rows]), table_frame, frame)
    try:
        return Markers(places, np.full_like(places, np.nan), [_own_std(row, usual) for row in rows], names)
    except MarkerError as error:
        error.args = (f"{rows[0].file}: {error}",)
        raise


@reads
def read_targets(
    path: str | os.PathLike[str], *, frame: Frame | None = None, table_frame: Frame | None = None
) -> dict[str, FloatArray]:
    """Read targets: inner points of the undeformed body whose places are of interest.

    Parameters
    ----------
    path : path-like
        Table ``target,x_mm,y_mm,z_mm`` with one target a row, or a point file of 3D Slicer (``.mrk.json``, ``.fcsv``, a
        table of control points).
    frame : {"LPS", "RAS"}, optional
        Patient frame of the mesh, into which the places are converted. By default, Slicer's points stay in the frame of
        their file, and a table's numbers are not converted.
    table_frame : {"LPS", "RAS"}, optional
        Patient frame of the numbers in a table, if it is not `frame`.

    Returns
    -------
    dict of str to ndarray of float64, shape (3,)
        Place of each target in mm by its name, in file order.

    Raises
    ------
    FormatError
        If the file cannot be read, a target stands in it twice or is not defined; the message names the place.
    MarkerError
        If a frame is none of the two, or `table_frame` is given without `frame`.
    """
    _check_frames(frame, table_frame)
    if is_point_file(path):
        return targets_of(path, frame)
    rows = read_table(path, ("target", *_PLACE), most_rows=FILES.table_points)
    names = _unique_names(rows, "target")
    places = turned(np.array([row.numbers(_PLACE) for row in rows]), table_frame, frame)
    return dict(zip(names, places, strict=True))


@reads
def read_named_points(path: str | os.PathLike[str], *, frame: Frame | None = None) -> dict[str, FloatArray]:
    """Read points with or without names, each (3,), in mm, in file order; without names they are 1, 2, 3 ...

    `path`: a table with ``x_mm,y_mm,z_mm`` and perhaps a column of unique names, ``target``, ``marker`` or ``point``;
    or a point file of 3D Slicer; `frame`: patient frame into which the latter's points are converted. Raises
    `FormatError` if the file cannot be read.
    """
    if is_point_file(path):
        return targets_of(path, frame)
    named = ("target", "marker", "point")
    rows = read_table(path, _PLACE, named)
    column = next((name for name in named if name in rows[0].cells), None)
    names = [str(1 + i) for i in range(len(rows))] if column is None else _unique_names(rows, column)
    return {name: np.array(row.numbers(_PLACE)) for name, row in zip(names, rows, strict=True)}


@reads
def read_seen(
    path: str | os.PathLike[str],
    std: float | None = None,
    *,
    frame: Frame | None = None,
    table_frame: Frame | None = None,
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Read where targets were seen, or were put by hand, in the deformed body; for `Markers.with_seen`.

    Parameters
    ----------
    path : path-like
        Table ``target,x_mm,y_mm,z_mm[,std_mm]`` with one target a row, empty (or ``nan``) if it was not seen; or a
        point file of 3D Slicer (``.mrk.json``, ``.fcsv``).
    std : float, optional
        Standard deviation in mm of a coordinate, for targets that state none themselves; 0.1 by default.
    frame, table_frame : {"LPS", "RAS"}, optional
        As in `read_targets`.

    Returns
    -------
    dict of str to ndarray of float64, shape (3,)
        Deformed place of each target in mm by its name, in file order; NaN where it was not seen.
    dict of str to float
        Standard deviation of its coordinates, mm.

    Raises
    ------
    FormatError
        If the file cannot be read, or a target stands in it twice; the message names the place.
    MarkerError
        If a frame is none of the two, `table_frame` is given without `frame`, or `std` is not positive.
    """
    _check_frames(frame, table_frame)
    usual = FILES.std_mm if std is None else real("std", std, above=0.0, unit="mm", error=MarkerError)
    if is_point_file(path):
        points = read_points(path).labelled()
        return dict(zip(points.names, points.places_in(frame), strict=True)), dict.fromkeys(points.names, usual)
    rows = read_table(path, ("target", *_PLACE), ("std_mm",), most_rows=FILES.table_points)
    names = _unique_names(rows, "target")
    places = turned(np.array([row.numbers(_PLACE, may_miss=True) for row in rows]), table_frame, frame)
    spread = [_own_std(row, usual)[0] for row in rows]
    return dict(zip(names, places, strict=True)), dict(zip(names, spread, strict=True))


@reads
def read_surface(
    path: str | os.PathLike[str], *, frame: Frame | None = None, table_frame: Frame | None = None
) -> FloatArray:
    """Read measured points of a deformed surface, without labels.

    Parameters
    ----------
    path : path-like
        Table ``x_mm,y_mm,z_mm`` with one point per row, or a point file of 3D Slicer, whose labels do not count.
    frame : {"LPS", "RAS"}, optional
        Patient frame of the mesh, into which the points are converted. By default nothing is converted.
    table_frame : {"LPS", "RAS"}, optional
        Patient frame of the numbers in the table, if it is not `frame`.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        Coordinates of the points in mm, in file order.

    Raises
    ------
    FormatError
        If the file cannot be read; the message names the line.
    MarkerError
        If a frame is none of the two, or `table_frame` is given without `frame`.
    """
    _check_frames(frame, table_frame)
    if is_point_file(path):
        return places_of(path, frame)
    return turned(np.array([row.numbers(_PLACE) for row in read_table(path, _PLACE)]), table_frame, frame)


def read_pairs(
    path: str | os.PathLike[str], *, frame: Frame | None = None, table_frame: Frame | None = None
) -> tuple[list[str], FloatArray, FloatArray]:
    """Read points known in the tracker's frame and in the body's: names, the former (n, 3) and the latter (n, 3), mm.

    `path`: table ``point,x_mm,y_mm,z_mm,tracker_x_mm,tracker_y_mm,tracker_z_mm``; `frame`, `table_frame`: as of
    `read_targets`, of the body's places. Raises `FormatError` if it cannot be read, or a point stands in it twice.
    """
    _check_frames(frame, table_frame)
    seen = tuple(f"tracker_{axis}" for axis in _PLACE)
    rows = read_table(path, ("point", *_PLACE, *seen), most_rows=FILES.table_points)
    body = turned(np.array([row.numbers(_PLACE) for row in rows]), table_frame, frame)
    return _unique_names(rows, "point"), np.array([row.numbers(seen) for row in rows]), body


def write_markers(path: str | os.PathLike[str], markers: Markers) -> None:
    """Write markers as a comma-separated table in mm that `read_markers` reads, whole or not at all.

    Cells of measured places are empty for markers that were not measured.
    """
    same = np.array_equal(markers.axis_std, markers.axis_std[:, [0, 0, 0]])
    spread = markers.axis_std[:, :1] if same else markers.axis_std
    rows = zip(markers.names, markers.reference, markers.measured, spread, strict=True)
    cells = [(name, *map(float, place), *map(float, seen), *map(float, std)) for name, place, seen, std in rows]
    write_table(path, ("marker", *_PLACE, *_MOVED, *(("std_mm",) if same else _STD)), cells)


def write_points(path: str | os.PathLike[str], points: Mapping[str, Any]) -> None:
    """Write targets (inner points), places (3,) in mm by name, as a table for `read_targets`, whole or not at all."""
    write_table(path, ("target", *_PLACE), [(name, *map(float, place)) for name, place in points.items()])


def write_targets(path: str | os.PathLike[str], targets: Mapping[str, Mapping[str, Any]]) -> None:
    """Write the registered places of targets (inner points of the body) as one table, whole or not at all.

    `targets`: for each target by name, as in ``registration.json``: its place on the undeformed body ``reference_mm
    (3,)``, its registered place ``mean_mm (3,)`` with ``covariance_mm2 (3, 3)``, the semi-axes ``region90_radii_mm
    (3,)`` of its 90 % region, and the place by the simulation ``simulation_mm (3,)`` or None.
    """
    header = ("target", *_PLACE, *_MOVED, *_COVARIANCE, *_RADII, *_SIMULATED)
    write_table(path, header, [(name, *_target_cells(values)) for name, values in targets.items()])


def write_tracked_targets(
    path: str | os.PathLike[str], moments: Iterable[tuple[float, Mapping[str, Mapping[str, Any]]]]
) -> None:
    """Write the registered places of targets (inner points) at many moments as one table, whole or not at all.

    `path`: the file. Its columns are ``time_s`` and those that `write_targets` writes; `moments`: for each moment its
    time in s and the targets by name, each with ``reference_mm (3,)``, ``mean_mm (3,)``, ``covariance_mm2 (3, 3)``,
    ``region90_radii_mm (3,)`` and ``simulation_mm (3,)`` or None.
    """
    rows = ((float(time_s), name, *_target_cells(one)) for time_s, all_of in moments for name, one in all_of.items())
    write_table(path, ("time_s", "target", *_PLACE, *_MOVED, *_COVARIANCE, *_RADII, *_SIMULATED), rows)


_COVARIANCE = ("cov_xx_mm2", "cov_xy_mm2", "cov_xz_mm2", "cov_yy_mm2", "cov_yz_mm2", "cov_zz_mm2")
_RADII = ("region90_a_mm", "region90_b_mm", "region90_c_mm")
_SIMULATED = ("simulated_x_mm", "simulated_y_mm", "simulated_z_mm")


def _target_cells(values: Mapping[str, Any]) -> list[float | None]:
    covariance = np.asarray(values["covariance_mm2"], dtype=np.float64)[np.triu_indices(3)]
    cells = [*values["reference_mm"], *values["mean_mm"], *covariance, *values["region90_radii_mm"]]
    simulated = values.get("simulation_mm")
    return [*map(float, cells), *((None, None, None) if simulated is None else map(float, simulated))]


def _check_frames(frame: Frame | None, table_frame: Frame | None) -> None:
    """Raise `MarkerError` if a frame is neither LPS nor RAS, or a table's frame is given without one to convert to."""
    for name, value in (("frame", frame), ("table_frame", table_frame)):
        if value is not None:
            check_choice(name, value, FRAMES, MarkerError)
    if table_frame is not None and frame is None:
        message = f"`table_frame` must come with `frame`, the one to convert to; got {table_frame} alone"
        raise MarkerError(message, where="table_frame")


def _own_std(row: Row, default: float) -> list[float]:
    own = row.number("std_mm") if row.cells.get("std_mm") else default
    return [row.number(name) if row.cells.get(name) else own for name in _STD]


def _unique_names(rows: list[Row], column: str) -> list[str]:
    first: dict[str, int] = {}
    for row in rows:
        name = row.text(column)
        if name in first:
            lines = f"line {first[name]} and line {row.line}"
            message = f"each {column} must stand in {row.file} once; '{name}' is at {lines}"
            raise FormatError(message, where=row.where)
        first[name] = row.line
    return list(first)
