"""Any table of markers, by a mapping that says which of its columns holds what."""

import csv
import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, bounded_stream
from tissuereg.io.csv import split_rows
from tissuereg.io.recordings.tracks import HowRead, Tracks, check_room, number_in

_AXES = ("x", "y", "z")
#: Lines in which the names of columns are looked for, to say which are there.
_MOST_ABOVE = 50
_KEY = re.compile(r"(?:^|\s)(time|frame|marker|unit|time_unit|(?:[^\s=]+\.)?[xyz])=")


def columns_in(text: str) -> dict[str, str]:
    """Return a mapping from a text such as ``time=Time (Seconds) x=X y=Y z=Z marker=Name unit=m``.

    >>> columns_in("time=Time (Seconds) tip.x=X 1 tip.y=Y 1 tip.z=Z 1")
    {'time': 'Time (Seconds)', 'tip.x': 'X 1', 'tip.y': 'Y 1', 'tip.z': 'Z 1'}
    """
    found = list(_KEY.finditer(text))
    if not found or found[0].start():
        message = f"columns must be told as 'time=Time (Seconds) x=X y=Y z=Z', got '{text[:80]}'"
        raise FormatError(message, where="columns")
    ends = [*(one.start() for one in found[1:]), len(text)]
    return {one[1]: text[one.end() : end].strip() for one, end in zip(found, ends, strict=True)}


def read_columns(file: Path, how: HowRead) -> Tracks:
    """Return the markers of a table by `how.columns`: one marker a row (``marker``), one in all, or several a row."""
    wanted = dict(how.columns)
    unit, time_unit = wanted.pop("unit", None), wanted.pop("time_unit", "s")
    seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    check_choice("time_unit of `columns`", time_unit, tuple(seconds), FormatError)
    prefixes = _markers(wanted)
    mm = how.millimetres(unit, file)
    moments: list[float] = []
    frames: list[dict[str, list[float]]] = []
    names: dict[str, None] = {}
    place: dict[str, int] = {}
    with bounded_stream(file, FILES.recording_mb) as stream:
        for line, cells in _rows_from(stream, list(wanted.values())):
            if not place:
                place = {key: _only(cells, name, file, line) for key, name in wanted.items()}
                continue
            if len(cells) <= max(place.values()):
                message = f"every row must have the columns named, got {len(cells)} cells at {file} line {line}"
                raise FormatError(message, where=f"{file}:{line}")
            moment = number_in(cells[place["time" if "time" in place else "frame"]], file, line)
            if not moments or moment != moments[-1] or "marker" not in place:
                moments.append(moment)
                frames.append({})
            for prefix in prefixes:
                name = cells[place["marker"]] if "marker" in place else prefix.rstrip(".") or "marker"
                names.setdefault(name)
                if name in frames[-1]:
                    message = f"each marker must stand once at one time, got '{name}' again at {file} line {line}"
                    raise FormatError(message, where=f"{file}:{line}")
                frames[-1][name] = [number_in(cells[place[prefix + axis]], file, line) for axis in _AXES]
            check_room(len(frames), 3 * len(names), file)
    if not frames:
        message = f"{file} must have a line with the columns {', '.join(wanted.values())}, and rows below it"
        if not place:
            message += _nearest_line(file, list(wanted.values()))
        raise FormatError(message, where=str(file))
    column = {name: i for i, name in enumerate(names)}
    places = np.full((len(frames), len(names), 3), np.nan)
    for k, frame in enumerate(frames):
        for name, found in frame.items():
            places[k, column[name]] = found
    clock = np.array(moments)
    times = seconds[time_unit] * clock if "time" in wanted else how.times_of(clock, file, "its rate")
    return Tracks("table by columns", times, list(names), mm * places)


def _rows_from(stream: BinaryIO, columns: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of the line that names all columns, and of those below it; none if no line does."""
    lines = (raw.decode("utf-8-sig") for raw in stream)
    for above, line in enumerate(lines):
        if all(name in line for name in columns) and set(columns) <= set(_cells(line)):
            rows = split_rows(itertools.chain([line], lines))
            yield from ((above + number, cells) for number, cells in rows)
            return


def _nearest_line(file: Path, columns: list[str]) -> str:
    """Return, for a message, which columns are missing in the line that names most of them, and what it has."""
    with bounded_stream(file, FILES.recording_mb) as stream:
        above = (raw.decode("utf-8-sig").strip("\r\n") for raw in itertools.islice(stream, _MOST_ABOVE))
        lines = [(number, cells) for number, line in enumerate(above, 1) if (cells := _cells(line))]
    if not lines:
        return ""
    # Of several, the first with most cells: units and numbers stand below the names.
    number, cells = max(lines, key=lambda one: (len(set(columns) & set(one[1])), len(one[1]), -one[0]))
    missing = ", ".join(f"'{name}'" for name in columns if name not in cells)
    return f"; line {number} lacks {missing} and has {', '.join(cells)[:300]}"


def _cells(line: str) -> list[str]:
    """Return the cells of a line, none if it is no row of a table: remarks may stand above the names."""
    try:
        return next((cells for _, cells in split_rows([line])), [])
    except csv.Error:
        return []


def _only(cells: list[str], name: str, file: Path, line: int) -> int:
    if cells.count(name) > 1:
        message = f"only one column may be named '{name}', got {cells.count(name)} at {file} line {line}"
        raise FormatError(message, where=f"{file}:{line}")
    return cells.index(name)


def _markers(wanted: Mapping[str, str]) -> list[str]:
    """Return what stands before x, y and z of each marker in the keys of a mapping, such as ``tip.``."""
    prefixes = list(dict.fromkeys(key[:-1] for key in wanted if key[-1] in _AXES and (len(key) == 1 or key[-2] == ".")))
    unknown = set(wanted) - {"time", "frame", "marker"} - {one + axis for one in prefixes for axis in _AXES}
    missing = [one + axis for one in prefixes for axis in _AXES if one + axis not in wanted]
    if unknown or missing or not prefixes or ("time" in wanted) == ("frame" in wanted):
        message = (
            "columns must name one of time and frame, x, y and z (or NAME.x, NAME.y, NAME.z of each marker), and may "
            f"name marker, unit and time_unit; got {', '.join(wanted)[:200] or 'none'}"
        )
        raise FormatError(message, where="columns")
    if "marker" in wanted and prefixes != [""]:
        message = "columns with `marker`, one marker a row, must name x, y and z alone"
        raise FormatError(message, where="columns")
    return prefixes
