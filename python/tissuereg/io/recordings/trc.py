"""Tables of markers by frame (.trc): five lines of header, then frame, time, and x, y, z of each marker, by tabs.

Nobody defines the format, and programs differ: the second and third line may have empty cells between theirs, the names
of markers stand over x (two empty cells between them), or follow each other with one empty cell or none between them,
``Time`` may be ``Times``, and a table that went through a spreadsheet has commas.
"""

import re
from pathlib import Path

import numpy as np

from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, bounded_stream
from tissuereg.io.recordings.tracks import HowRead, Tracks, check_room, number_in, rows_of, unique, without_zeros

_HEAD = "PathFileType"


def is_trc(head: str) -> bool:
    """Return whether a file begins as such a table."""
    return head.startswith(_HEAD)


def read_trc(file: Path, how: HowRead) -> Tracks:
    """Return the markers of a .trc file; an empty cell is a place that was not measured."""
    rows = rows_of(file, _delimiter(file))
    head = [cells for _, (_, cells) in zip(range(4), rows, strict=False)]
    if len(head) < 4 or not re.match(r"frame#?\ttimes?\t", "\t".join([*head[3][:2], ""]), re.IGNORECASE):
        message = f"{file} must have five lines of header, the fourth with Frame#, Time and the markers"
        raise FormatError(message, where=f"{file}:4")
    mm = how.millimetres(_stated(head[1], head[2]).get("units"), file)
    names, over_x = _names(head[3])
    found: list[list[float]] = []
    for line, cells in rows:
        axes = not found and re.fullmatch(r"[Xx]\d*", next(filter(None, cells))) is not None
        if axes and (over_x or sum(map(bool, cells)) == 3 * len(names)):
            continue  # the fifth line, X1 Y1 Z1 ...
        if axes or any(cells[2 + 3 * len(names) :]):
            # One name too few or too many, and all that follow would have the places of others.
            n, what = sum(map(bool, cells)), "axes" if axes else "cells"
            message = (
                f"{file} must name all its markers in line 4, got {len(names)} names, and {n} {what} in line {line}"
            )
            raise FormatError(message, where=f"{file}:4")
        numbers = [number_in(cell, file, line) for cell in cells[1 : 2 + 3 * len(names)]]
        found.append([*numbers, *[np.nan] * (1 + 3 * len(names) - len(numbers))])
        check_room(len(found), len(found[0]), file)
    if not found or not names:
        message = f"{file} must hold at least one marker and one frame"
        raise FormatError(message, where=str(file))
    numbers_of = np.array(found)
    places, notes = without_zeros(names, mm * numbers_of[:, 1:].reshape(len(found), len(names), 3))
    return Tracks("TRC", numbers_of[:, 0], names, places, notes=notes)


def _delimiter(file: Path) -> str:
    with bounded_stream(file, FILES.recording_mb) as stream:
        return "," if stream.readline(FILES.head_bytes).decode("utf-8-sig", "replace").startswith(_HEAD + ",") else "\t"


def _stated(keys: list[str], values: list[str]) -> dict[str, str]:
    """Return what the second and third line say, by its name in lower case."""
    dense = [[cell for cell in cells if cell] for cells in (keys, values)]
    if len(dense[0]) == len(dense[1]):
        keys, values = dense
    return {key.lower(): value for key, value in zip(keys, values, strict=False)}


def _names(cells: list[str]) -> tuple[list[str], bool]:
    """Return the names of the markers in the fourth line, and whether each stands over x."""
    titles = cells[2:]
    while titles and not titles[-1]:
        titles.pop()
    over_x = all(not title for i, title in enumerate(titles) if i % 3)
    titles = titles[::3] if over_x else [title for title in titles if title]
    return unique([title or f"P{i + 1}" for i, title in enumerate(titles)]), over_x
