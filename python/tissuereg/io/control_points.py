"""Tables of control points that 3D Slicer exports (.csv, .tsv): a point a line, the frame by the columns' names."""

import csv
import math
import os
from collections.abc import Sequence
from pathlib import Path

from tissuereg._base.arguments import place
from tissuereg._base.choices import Frame
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, existing_file, text_lines
from tissuereg.io.csv import split_rows
from tissuereg.io.points import NamedPoints

#: Columns of the coordinates, in mm, and the frame that they state.
_FRAMES: dict[tuple[str, str, str], Frame] = {("r", "a", "s"): "RAS", ("l", "p", "s"): "LPS"}
_ENDINGS = (".csv", ".tsv", ".txt")
_DEFINED = {"1": True, "true": True, "0": False, "false": False}


def is_control_point_table(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a table of control points: its header has ``label`` and ``r,a,s`` or ``l,p,s``.

    Only the head of a regular file that ends in ``.csv``, ``.tsv`` or ``.txt`` is read.
    """
    file = place("path", path, error=FormatError)
    if file.suffix.lower() not in _ENDINGS or not file.is_file() or not os.access(file, os.R_OK):
        return False
    with file.open("rb") as stream:
        head = stream.read(FILES.head_bytes).decode("utf-8-sig", errors="replace")
    try:
        _, cells = next(split_rows(head.splitlines(keepends=True)), (1, []))
    except csv.Error:
        return False
    columns = _columns(cells)
    return "label" in columns and any(set(axes) <= set(columns) for axes in _FRAMES)


def read_control_points(path: str | os.PathLike[str]) -> NamedPoints:
    """Read the named points in a table of control points of 3D Slicer, with their places in mm in the table's frame.

    `path`: text, its cells parted as `split_rows` has it, with the columns ``label`` and ``r,a,s`` or ``l,p,s``, in any
    order; others are passed over. A point whose coordinates are empty, or whose cell of a column ``defined`` is 0, gets
    NaN as its place. Raises `FormatError` if the file is no such table; the message names the line.
    """
    file = existing_file(path, FILES.text_mb)
    try:
        lines = text_lines(file)
        rows = list(split_rows(f"{line}\n" for line in lines))
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        message = f"{file} must be a table of control points in UTF-8 text; it cannot be read: {error}"
        raise FormatError(message, where=str(file)) from error
    (_, first), *below = rows or [(1, [])]
    columns = _columns(first)
    axes = _axes(file, columns)
    return NamedPoints.of(file, _FRAMES[axes], [_point(file, line, columns, axes, cells) for line, cells in below])


def _columns(cells: Sequence[str]) -> list[str]:
    return [cell.lower() for cell in cells]


def _axes(file: Path, columns: list[str]) -> tuple[str, str, str]:
    found = [axes for axes in _FRAMES if set(axes) <= set(columns)]
    if len(found) != 1 or columns.count("label") != 1 or any(columns.count(name) != 1 for name in found[0]):
        message = f"{file} must have the columns label and either r,a,s or l,p,s, once each, got '{','.join(columns)}'"
        raise FormatError(message, where=f"{file}:1")
    return found[0]


def _point(
    file: Path, line: int, columns: list[str], axes: tuple[str, str, str], cells: list[str]
) -> tuple[str, str, tuple[float, float, float]]:
    where = f"{file} line {line}"
    if len(cells) != len(columns):
        message = f"every row must have {len(columns)} cells, got {len(cells)} at {where}"
        raise FormatError(message, where=f"{file}:{line}")
    row = dict(zip(columns, cells, strict=True))
    defined = _DEFINED.get(row.get("defined", "1").lower())
    if defined is None:
        message = f"column 'defined' must hold 1 or 0, got '{row['defined']}' at {where}"
        raise FormatError(message, where=f"{file}:{line}")
    texts = [row[name] for name in axes]
    if not defined or all(text.lower() in ("", "nan") for text in texts):
        return f"line {line}", row["label"], (math.nan, math.nan, math.nan)
    try:
        x, y, z = (float(text) for text in texts)
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        message = f"{','.join(axes)} must be finite numbers, got '{','.join(texts)}' at {where}"
        raise FormatError(message, where=f"{file}:{line}")
    return f"line {line}", row["label"], (x, y, z)
