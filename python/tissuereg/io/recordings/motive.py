"""Exports of OptiTrack Motive (CSV, format 1.2x): markers by column, blank where occluded; y is up as a rule.

Columns of the type *Marker* are measurements. Those of *Rigid Body Marker* and *Bone Marker* are where a model expects
its markers, also while they are hidden: they are never read. The pose of a rigid body is a tool.

Up to format 1.21 the rows of types, names and IDs have no name of their own, and the time's column is ``Time``.
"""

import re
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES
from tissuereg.io.recordings.tracks import (
    HowRead,
    Tracks,
    check_room,
    number_in,
    offset_notes,
    rotations,
    rows_of,
    tool_places,
    unique,
)

_UNLABELLED = "unlabeled"
_ROWS = ("type", "name", "id")


class _Column(NamedTuple):
    """A column: type of its object, the object's name, what is measured (``position``, ``rotation``), and the axis."""

    type: str
    name: str
    id: str
    quantity: str
    axis: str


class _Heading(NamedTuple):
    """What the lines above the numbers say: keys and values of the first, the columns, and the column of the time."""

    stated: dict[str, str]
    columns: list[_Column]
    time: int


def is_motive(head: str) -> bool:
    """Return whether the beginning of a file is that of such an export, with or without its first line."""
    lines = head.splitlines()[: FILES.header_rows]
    bare = [line.replace('"', "").lower() for line in lines]
    return bare[:1] != [] and (
        bare[0].startswith("format version,") or any(line.startswith("frame,time (seconds)") for line in bare)
    )


def read_motive(file: Path, how: HowRead) -> Tracks:
    """Return the markers of an export, and its rigid bodies where it has no markers or an offset names them."""
    rows = rows_of(file)
    header = _header(file, rows)
    markers, tools = _objects(header, {"marker"}), _objects(header, {"rigid body"})
    wanted = {key: tools[key] for key in tools if not markers or key[0] in how.offsets}
    if not markers and not wanted:
        expected = _objects(header, {"rigid body marker", "bone marker"})
        why = "expected places of a model's markers, which persist while they are hidden" if expected else "none"
        message = f"{file} must hold columns of the type Marker, got {why}: export it with markers"
        raise FormatError(message, where=str(file))
    mm = how.millimetres(header.stated.get("length units"), file)
    used = sorted({header.time, *(i for one in (*markers.values(), *wanted.values()) for i in one.values())})
    numbers = _numbers(file, rows, header, used)
    column = {i: numbers[:, k] for k, i in enumerate(used)}
    names = [name for name, _ in markers]
    places = [mm * _stacked(column, one, "position", "xyz") for one in markers.values()]
    notes = offset_notes([name for name, _ in wanted], how.offsets) if wanted or how.offsets else []
    for (name, _), one in wanted.items():
        quaternion = all(("rotation", axis) in one for axis in "wxyz")
        turns = rotations(_stacked(column, one, "rotation", "wxyz")) if quaternion else None
        origins = mm * _stacked(column, one, "position", "xyz")
        places.append(tool_places(turns, origins, how.offsets.get(name)))
        names.append(name)
    notes += _notes(header, len(tools) - len(wanted))
    names = unique(names)
    made_up = {name for name in names if name.lower().startswith(_UNLABELLED)}
    return Tracks(
        f"Motive CSV {header.stated.get('format version', '')}".strip(),
        column[header.time],
        names,
        np.stack(places, axis=1),
        up="y",
        notes=notes,
        unlabelled=made_up,
    )


def _notes(header: _Heading, n_unread: int) -> list[str]:
    notes = ["Motive's frame: y is up, unless its export was set otherwise"]
    if "coordinate space" in header.stated and header.stated["coordinate space"].lower() != "global":
        notes.append(f"coordinate space {header.stated['coordinate space']}: places may not be in one frame")
    if n_unread:
        notes.append(f"{n_unread} rigid bodies are not read; an offset makes one a marker")
    if _objects(header, {"rigid body marker", "bone marker"}):
        notes.append("expected places of rigid bodies' markers are not read: they are no measurements")
    return notes


def _header(file: Path, rows: Iterator[tuple[int, list[str]]]) -> _Heading:
    """Read the lines above the numbers; `rows`: iterator of line numbers and cells, which is left below them."""
    stated: dict[str, str] = {}
    lines: dict[str, list[str]] = {}
    bare: list[list[str]] = []
    before: list[str] = []
    for _, (number, cells) in zip(range(FILES.header_rows), rows, strict=False):
        if cells[0].lower() == "frame":
            width = len(cells)
            time = next((i for i, cell in enumerate(cells) if re.match(r"time( \(s|$)", cell.lower())), -1)
            lines = lines or dict(zip(_ROWS, bare[:-1], strict=False))  # the last one is that of quantities
            if time < 0 or "type" not in lines or "name" not in lines:
                message = (
                    f"{file} must have a column 'Time (Seconds)' and header rows Type and Name above line {number}"
                )
                raise FormatError(message, where=f"{file}:{number}")
            of = {key: [*line, *[""] * width][:width] for key, line in {**lines, "": before}.items()}
            ids = of.get("id", [""] * width)
            parts = zip(of["type"], of["name"], ids, of[""], cells, strict=True)
            return _Heading(stated, [_Column(t.lower(), n, i, q.lower(), a.lower()) for t, n, i, q, a in parts], time)
        if not lines and len(cells) > 1 and cells[0]:
            stated |= {key.lower(): value for key, value in zip(cells[::2], cells[1::2], strict=False)}
        elif len(cells) > 1 and cells[1]:
            lines[cells[1].lower()] = cells
        else:
            bare.append(cells)
        before = cells
    message = f"{file} must have a row that begins with Frame within its first {FILES.header_rows} lines"
    raise FormatError(message, where=str(file))


def _objects(header: _Heading, types: set[str]) -> dict[tuple[str, str], dict[tuple[str, str], int]]:
    """Return the columns of every object of these types, by its name and id, by quantity and axis."""
    found: dict[tuple[str, str], dict[tuple[str, str], int]] = {}
    for i, one in enumerate(header.columns):
        if one.type in types and one.name:
            own = found.setdefault((one.name, one.id), {})
            if (one.quantity, one.axis) in own:
                message = f"each {one.type} must stand once, or with an ID of its own; got '{one.name}' twice"
                raise FormatError(message, where=one.name)
            own[one.quantity, one.axis] = i
    return {key: one for key, one in found.items() if all(("position", axis) in one for axis in "xyz")}


def _numbers(file: Path, rows: Iterator[tuple[int, list[str]]], header: _Heading, used: list[int]) -> FloatArray:
    """Return the numbers of the columns `used` in every row, (n_frames, n), NaN where a cell is blank."""
    found, n_frames = array("d"), 0
    for number, cells in rows:
        if len(cells) != len(header.columns):
            message = f"every row must have {len(header.columns)} cells, got {len(cells)} at {file} line {number}"
            raise FormatError(message, where=f"{file}:{number}")
        found.extend(number_in(cells[i], file, number) for i in used)
        n_frames += 1
        check_room(n_frames, len(used), file)
    if not n_frames:
        message = f"{file} must hold at least one frame below its header"
        raise FormatError(message, where=str(file))
    return np.frombuffer(found).reshape(n_frames, len(used))


def _stacked(column: dict[int, FloatArray], one: dict[tuple[str, str], int], quantity: str, axes: str) -> FloatArray:
    return np.stack([column[one[quantity, axis]] for axis in axes], axis=1)
