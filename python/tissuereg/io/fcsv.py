"""Fiducials of 3D Slicer as text (``.fcsv``): comment lines with frame and columns, then one point per line, mm."""

import csv
import math
import os
import re
from pathlib import Path

from tissuereg._base.choices import Frame
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, existing_file, text_lines
from tissuereg.io.points import NamedPoints

_COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
_NEEDED = ("x", "y", "z", "label")

#: Older versions of Slicer number the frames (2 is the voxels of an image), newer ones spell them.
_FRAMES: dict[str, Frame] = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}
#: Numbers of a position's status in two unnamed cells at the end of a line; 2 is a defined one.
_NOT_DEFINED = ("0", "1", "3")
_SETTING = re.compile(r"\s*#\s*(CoordinateSystem|columns)\s*[=:]\s*(.*)$", re.IGNORECASE)


def read_fcsv(path: str | os.PathLike[str]) -> NamedPoints:
    """Read the named points in a file of fiducials of 3D Slicer, with their places in mm in the file's frame.

    `path`: a text file with the line ``# CoordinateSystem = LPS`` (or RAS, or 1 and 0 for the two). A point whose
    coordinates are empty is not defined and gets NaN as its place, as does one that has the number of another status
    behind the named columns (0 undefined, 1 preview, 3 missing), where Slicer 5 puts it. Raises `FormatError` if the
    file is missing, does not state its frame, or a line is not a point; the message names the line.
    """
    file = existing_file(path, FILES.text_mb)
    try:
        lines = text_lines(file)
    except (UnicodeDecodeError, OSError) as error:
        message = f"{file} must be fiducials in UTF-8 text; it cannot be read: {error}"
        raise FormatError(message, where=str(file)) from error
    frame, columns = _head(file, lines)
    points = [
        _point(file, number, columns, line)
        for number, line in enumerate(lines, 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    return NamedPoints.of(file, frame, points)


def _head(file: Path, lines: list[str]) -> tuple[Frame, list[str]]:
    """Return the frame of the file, ``LPS`` or ``RAS``, and the names of its columns, from its comment lines."""
    frame, columns = None, _COLUMNS.split(",")
    for number, line in enumerate(lines, 1):
        found = _SETTING.match(line)
        if found is None:
            continue
        name, value = found.group(1).lower(), found.group(2).strip()
        if name == "columns":
            columns = [column.strip() for column in value.split(",")]
            missing = [column for column in _NEEDED if column not in columns]
            if missing:
                message = f"the columns of {file} must be {_COLUMNS}; {', '.join(missing)} is missing at line {number}"
                raise FormatError(message, where=f"{file}:{number}")
            continue
        stated = _FRAMES.get(value.rstrip(",").upper())  # a spreadsheet fills lines up with commas
        if stated is None or frame not in (None, stated):
            words = "LPS, RAS, 1 or 0" if stated is None else f"{frame}, as it is stated before"
            message = f"CoordinateSystem must be {words}, got '{value}' at {file} line {number}"
            raise FormatError(message, where=f"{file}:{number}")
        frame = stated
    if frame is None:
        message = f"{file} must state its frame in a line '# CoordinateSystem = LPS' (or RAS); there is none"
        raise FormatError(message, where=str(file))
    return frame, columns


def _point(file: Path, number: int, columns: list[str], line: str) -> tuple[str, str, tuple[float, float, float]]:
    try:
        (cells,) = csv.reader([line], strict=True)
    except csv.Error as error:
        message = f"{file} must hold comma-separated text; line {number} cannot be read: {error}"
        raise FormatError(message, where=f"{file}:{number}") from error
    needed = 1 + max(columns.index(name) for name in _NEEDED)
    if len(cells) < needed:
        message = f"every point must have {needed} cells or more, got {len(cells)} at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}")
    texts = [cells[columns.index(name)].strip() for name in _NEEDED]
    beyond = cells[len(columns) :]
    if len(beyond) == 2 and beyond[0].strip() in _NOT_DEFINED:
        return f"line {number}", texts[3], (math.nan, math.nan, math.nan)
    x, y, z = _place(file, number, texts[:3])
    return f"line {number}", texts[3], (x, y, z)


def _place(file: Path, number: int, texts: list[str]) -> list[float]:
    if all(text.lower() in ("", "nan") for text in texts):
        return [math.nan] * 3
    try:
        place = [float(text) for text in texts]
    except ValueError:
        place = [math.nan]
    if not all(map(math.isfinite, place)):
        message = f"x, y, z must be finite numbers, got '{','.join(texts)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}")
    return place
