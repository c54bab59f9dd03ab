"""Markers and targets as comma-separated tables, lengths in mm; readers take the files of 3D Slicer as well."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, place
from tissuereg._base.arrays import FloatArray
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import PATIENT_FRAMES
from tissuereg.errors import FormatError, MarkerError
from tissuereg.io.bounds import FILES
from tissuereg.io.csv import Row, read_table, write_table
from tissuereg.io.point_files import is_point_file, markers_of, reference_of, targets_of
from tissuereg.io.points import turned

_PLACE = ("x_mm", "y_mm", "z_mm")
_MOVED = ("moved_x_mm", "moved_y_mm", "moved_z_mm")
_STD = ("std_x_mm", "std_y_mm", "std_z_mm")


def read_markers(
    path: str | os.PathLike[str],
    std: float | None = None,
    *,
    measured: str | os.PathLike[str] | None = None,
    frame: str | None = None,
    table_frame: str | None = None,
) -> Markers:
    """Read the markers of one moment.

    Parameters
    ----------
    path : path-like
        Table ``marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm]``: the marker's place on or
        off the undeformed surface, then where it was measured; empty (or ``nan``) = not seen. Columns
        ``std_x_mm,std_y_mm,std_z_mm`` may follow where axes differ; an empty cell takes the marker's own or `std`.
        Or points of 3D Slicer (``.mrk.json``, ``.fcsv``): where the markers sit.
    std : float, optional
        Standard deviation in mm of a measured coordinate, for markers without their own; 0.1 where absent.
    measured : path-like, optional
        With points of 3D Slicer: points where the markers were seen, with the same labels. One that is missing, or
        whose status is not ``defined``, was not seen.
    frame : {"LPS", "RAS"}, optional
        Frame of the mesh, in which the markers are wanted. Where absent, that of the file `path`, or a table's numbers
        as they are.
    table_frame : {"LPS", "RAS"}, optional
        Frame of the numbers in a table, where it is not `frame`.

    Returns
    -------
    Markers
        In file order, markers that were not seen included.

    Raises
    ------
    FormatError
        If a file cannot be read, or a marker stands in it twice; the message names the line. If `measured` does not go
        with `path`, or has a label that `path` lacks.
    MarkerError
        If a standard deviation is not positive, a frame none of the two, or `table_frame` given without `frame`.
    """
    _check_frames(frame, table_frame)
    path = place("path", path, error=FormatError)
    measured = None if measured is None else place("measured", measured, error=FormatError)
    usual = FILES.std_mm if std is None else std
    if is_point_file(path) or (measured is not None and is_point_file(measured)):
        return markers_of(path, measured, usual, frame)
    if measured is not None:
        message = f"a table of markers holds where they were seen itself; {measured} must be left out with {path}"
        raise FormatError(message, where=str(measured))
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


def read_reference(
    path: str | os.PathLike[str],
    std: float | None = None,
    *,
    frame: str | None = None,
    table_frame: str | None = None,
) -> Markers:
    """Read where markers sit on the undeformed body, without a moment at which they were seen.

    `path`: table ``marker,x_mm,y_mm,z_mm[,std_mm]``, or that of `read_markers`, whose measured places are left aside.
    Or points of 3D Slicer (``.mrk.json``, ``.fcsv``); `std`: standard deviation in mm of a measured coordinate, for
    markers without their own; 0.1 where absent; `frame`, `table_frame` {"LPS", "RAS"}: as in `read_markers`. Result: in
    file order, none of them seen. Raises `FormatError` if the file cannot be read, or a marker stands in it twice; the
    message names the line; `MarkerError` if a standard deviation is not positive, a frame none of the two, or
    `table_frame` given without `frame`.
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


def read_targets(
    path: str | os.PathLike[str], *, frame: str | None = None, table_frame: str | None = None
) -> dict[str, FloatArray]:
    """Read inner points of the undeformed body.

    Parameters
    ----------
    path : path-like
        Table ``target,x_mm,y_mm,z_mm``, or points of 3D Slicer (``.mrk.json``, ``.fcsv``).
    frame : {"LPS", "RAS"}, optional
        Frame of the mesh, in which they are wanted. Where absent, Slicer's points stay in the file's frame and a
        table's numbers as they are.
    table_frame : {"LPS", "RAS"}, optional
        Frame of the numbers in a table, where it is not `frame`.

    Returns
    -------
    dict of str to ndarray of float64, shape (3,)
        Place in mm by name, in file order.

    Raises
    ------
    FormatError
        If the file cannot be read, a target stands in it twice or is not defined; the message names the place.
    MarkerError
        If a frame is none of the two.
    """
    _check_frames(frame, table_frame)
    if is_point_file(path):
        return targets_of(path, frame)
    rows = read_table(path, ("target", *_PLACE), most_rows=FILES.table_points)
    names = _unique_names(rows, "target")
    places = turned(np.array([row.numbers(_PLACE) for row in rows]), table_frame, frame)
    return dict(zip(names, places, strict=True))


def read_surface(
    path: str | os.PathLike[str], *, frame: str | None = None, table_frame: str | None = None
) -> FloatArray:
    """Read points of a deformed surface, without labels.

    Parameters
    ----------
    path : path-like
        Table ``x_mm,y_mm,z_mm``.
    frame : {"LPS", "RAS"}, optional
        Frame of the mesh, in which they are wanted; where absent, the numbers are taken as they are.
    table_frame : {"LPS", "RAS"}, optional
        Frame of the numbers in the table, where it is not `frame`.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        mm, in file order.

    Raises
    ------
    FormatError
        If the table cannot be read; the message names the line.
    MarkerError
        If a frame is none of the two.
    """
    _check_frames(frame, table_frame)
    return turned(np.array([row.numbers(_PLACE) for row in read_table(path, _PLACE)]), table_frame, frame)


def write_markers(path: str | os.PathLike[str], markers: Markers) -> None:
    """Write markers as `read_markers` reads them, whole or not at all.

    `markers`: those that were not seen get empty cells.
    """
    same = np.array_equal(markers.axis_std, markers.axis_std[:, [0, 0, 0]])
    spread = markers.axis_std[:, :1] if same else markers.axis_std
    rows = zip(markers.names, markers.reference, markers.measured, spread, strict=True)
    cells = [(name, *map(float, place), *map(float, seen), *map(float, std)) for name, place, seen, std in rows]
    write_table(path, ("marker", *_PLACE, *_MOVED, *(("std_mm",) if same else _STD)), cells)


def write_points(path: str | os.PathLike[str], points: Mapping[str, Any]) -> None:
    """Write inner points of the undeformed body as `read_targets` reads them, whole or not at all.

    `points` (3,): mm.
    """
    write_table(path, ("target", *_PLACE), [(name, *map(float, place)) for name, place in points.items()])


def write_targets(path: str | os.PathLike[str], targets: Mapping[str, Mapping[str, Any]]) -> None:
    """Write registered targets as a table, whole or not at all.

    `targets`: each with ``reference_mm (3,)``, ``mean_mm (3,)``, ``covariance_mm2 (3, 3)``, ``region90_radii_mm (3,)``
    and ``simulation_mm (3,)`` or None, as in ``registration.json``.
    """
    header = ("target", *_PLACE, *_MOVED, *_COVARIANCE, *_RADII, *_SIMULATED)
    write_table(path, header, [(name, *_target_cells(values)) for name, values in targets.items()])


def write_tracked_targets(
    path: str | os.PathLike[str], moments: Iterable[tuple[float, Mapping[str, Mapping[str, Any]]]]
) -> None:
    """Write registered targets of many moments as one table, whole or not at all.

    `path`: where to. The columns are ``time_s`` and those of `write_targets`; `moments`: time in s, and the targets as
    `write_targets` takes them.
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


def _check_frames(frame: str | None, table_frame: str | None) -> None:
    """Refuse an unknown frame, and a table's frame without a frame to convert to."""
    for name, value in (("frame", frame), ("table_frame", table_frame)):
        if value is not None:
            check_choice(name, value, PATIENT_FRAMES, MarkerError)
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


@dataclass(frozen=True, eq=False)
class Recording:
    """Where markers were seen, frame after frame; iterating gives ``(time_s, measured_mm)``, as `Tracker.run` takes.

    `times` (n_frames,): s, ascending; `measured` (n_frames, n_markers, 3): mm; NaN = not seen.
    """

    times: FloatArray
    measured: FloatArray

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[tuple[float, FloatArray]]:
        return zip(self.times.tolist(), self.measured, strict=True)


def read_recording(
    path: str | os.PathLike[str],
    names: Sequence[str],
    *,
    frame: str | None = None,
    table_frame: str | None = None,
) -> Recording:
    """Read a recording of markers.

    `path`: table ``time_s,marker,x_mm,y_mm,z_mm``, a row for each marker that was seen, in the order of time. A marker
    without a row at some time, or with empty cells, was not seen then; `names`: the markers, in the order in which they
    are wanted; `frame`, `table_frame` {"LPS", "RAS"}: frame of the mesh, and that of the table where it is another one.
    Result: one frame for each time in the table. Raises `FormatError` if the table cannot be read, has a marker that is
    not among `names` or twice at one time, or if time goes back; the message names the line.
    """
    index = {name: i for i, name in enumerate(names)}
    times: list[float] = []
    frames: list[FloatArray] = []
    first: dict[str, int] = {}
    for row in read_table(path, ("time_s", "marker", *_PLACE)):
        time_s, name = row.number("time_s"), row.text("marker")
        if name not in index:
            message = f"every marker must be one of the reference ({', '.join(index)}), got '{name}' at {_at(row)}"
            raise FormatError(message, where=row.where)
        if times and time_s < times[-1]:
            message = f"time must not go back; {time_s:.9g} s at {_at(row)} follows {times[-1]:.9g} s"
            raise FormatError(message, where=row.where)
        if not times or time_s > times[-1]:
            times.append(time_s)
            frames.append(np.full((len(index), 3), np.nan))
            first = {}
        if name in first:
            message = f"each marker must stand once at one time; '{name}' at {_at(row)} is at line {first[name]} too"
            raise FormatError(message, where=row.where)
        first[name] = row.line
        frames[-1][index[name]] = row.numbers(_PLACE, may_miss=True)
    return Recording(np.array(times), turned(np.array(frames), table_frame, frame))


def _at(row: Row) -> str:
    return f"{row.file} line {row.line}"
