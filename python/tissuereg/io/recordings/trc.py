"""Tables of markers by frame (.trc): five lines of header, then frame, time, and x, y, z of each marker, by tabs."""

from pathlib import Path

import numpy as np

from tissuereg.errors import FormatError
from tissuereg.io.recordings.tracks import HowRead, Tracks, check_room, number_in, rows_of, unique, without_zeros

_HEAD = "PathFileType"


def is_trc(head: str) -> bool:
    """Return whether a file begins as such a table."""
    return head.startswith(_HEAD)


def read_trc(file: Path, how: HowRead) -> Tracks:
    """Return the markers of a .trc file; an empty cell is a place that was not measured."""
    rows = rows_of(file, "\t")
    head = [cells for _, (_, cells) in zip(range(4), rows, strict=False)]
    if len(head) < 4 or len(head[3]) < 2 or [cell.lower() for cell in head[3][:2]] != ["frame#", "time"]:
        message = f"{file} must have five lines of header, the fourth with Frame#, Time and the markers"
        raise FormatError(message, where=f"{file}:4")
    stated = {key.lower(): value for key, value in zip(head[1], head[2], strict=False)}
    mm = how.millimetres(stated.get("units"), file)
    titles = head[3][2::3]
    while titles and not titles[-1]:
        titles.pop()
    names = unique([title or f"P{i + 1}" for i, title in enumerate(titles)])
    found: list[list[float]] = []
    for line, cells in rows:
        if not cells[0] and any(cell.upper().startswith("X") for cell in cells):
            continue  # the fifth line, X1 Y1 Z1 ...
        numbers = [number_in(cell, file, line) for cell in cells[1 : 2 + 3 * len(names)]]
        found.append([*numbers, *[np.nan] * (1 + 3 * len(names) - len(numbers))])
        check_room(len(found), len(found[0]), file)
    if not found or not names:
        message = f"{file} must hold at least one marker and one frame"
        raise FormatError(message, where=str(file))
    numbers_of = np.array(found)
    places, notes = without_zeros(names, mm * numbers_of[:, 1:].reshape(len(found), len(names), 3))
    return Tracks("TRC", numbers_of[:, 0], names, places, notes=notes)
