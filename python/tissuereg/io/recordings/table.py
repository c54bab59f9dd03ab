"""Recordings as tissuereg writes them: a table with a row for each marker at each time."""

from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.csv import Row, read_table
from tissuereg.io.recordings.tracks import HowRead, Tracks

COLUMNS = ("time_s", "marker", "x_mm", "y_mm", "z_mm")

#: Whether a live run registered the frame, 1 or 0.
REGISTERED = "registered"


def read_own_table(file: Path, how: HowRead) -> Tracks:
    """Return a table ``time_s,marker,x_mm,y_mm,z_mm[,registered]``, in the order of time; refuse it by its line."""
    rows = read_table(file, COLUMNS, (REGISTERED,))
    times: list[float] = []
    frames: list[dict[str, FloatArray]] = []
    first: dict[str, str] = {}
    taken: list[bool] = []
    lines: dict[str, int] = {}
    listed = 0
    for row in rows:
        time_s, name = row.number("time_s"), row.text("marker")
        if times and time_s < times[-1]:
            message = f"time must not go back; {time_s:.9g} s at {_at(row)} follows {times[-1]:.9g} s"
            raise FormatError(message, where=row.where)
        if not times or time_s > times[-1]:
            listed = listed or len(first)
            times.append(time_s)
            frames.append({})
            taken.append(row.cells.get(REGISTERED, "1") != "0")
            lines = {}
        if name in lines:
            message = f"each marker must stand once at one time; '{name}' at {_at(row)} is at line {lines[name]} too"
            raise FormatError(message, where=row.where)
        lines[name] = row.line
        first.setdefault(name, f"line {row.line}")
        frames[-1][name] = np.array(row.numbers(COLUMNS[2:], may_miss=True))
    places = np.full((len(times), len(first), 3), np.nan)
    column = {name: i for i, name in enumerate(first)}
    for k, frame in enumerate(frames):
        for name, place in frame.items():
            places[k, column[name]] = place
    live = np.array(taken) if REGISTERED in rows[0].cells else None
    where, names = list(first.values()), list(first)
    words = "table time_s,marker,x_mm,y_mm,z_mm"
    return Tracks(words, np.array(times), names, places, registered=live, where=where, listed=listed or len(first))


def _at(row: Row) -> str:
    return f"{row.file} line {row.line}"
