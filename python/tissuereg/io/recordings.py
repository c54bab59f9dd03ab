"""Recordings of markers, frame after frame, as comma-separated tables, lengths in mm."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.csv import Row, read_table
from tissuereg.io.points import turned

_PLACE = ("x_mm", "y_mm", "z_mm")


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
