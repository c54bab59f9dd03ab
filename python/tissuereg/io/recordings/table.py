"""Recordings as tissuereg writes them: a table with a row for each marker at each time."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from math import isnan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import FILES
from tissuereg.io.csv import Row, table_rows
from tissuereg.io.recordings.tracks import HowRead, Tracks, check_room

COLUMNS = ("time_s", "marker", "x_mm", "y_mm", "z_mm")

#: What a live run adds: whether it registered the frame, 1 or 0; when it came, by a clock that never jumps; a digest of
#: its answer; all in a frame's first row. And what the sender calls a marker, where that is another name.
REGISTERED, RECEIVED, ANSWER, SENT_AS = "registered", "received_s", "answer", "sent_as"


class LiveRow(NamedTuple):
    """A frame of a live run: `places` (n_markers, 3), mm, NaN where not seen, at `time_s`; it came at `received_s`, s.

    `registered`: whether it was, others came too fast; `answer`: digest of its answer, ``failed``, or empty where none
    is known; `sent_as`: what the sender calls each marker, empty where it was not sent.
    """

    time_s: float
    places: FloatArray
    received_s: float
    sent_as: Sequence[str] = ()
    registered: bool = False
    answer: str = ""


def read_own_table(file: Path, how: HowRead) -> Tracks:
    """Return a table ``time_s,marker,x_mm,y_mm,z_mm``, in the order of time; refuse it by its line.

    One of a live run has further columns.
    """
    times: list[float] = []
    frames: list[dict[str, tuple[float, ...]]] = []
    first: dict[str, str] = {}
    taken: list[bool] = []
    answers: list[str] = []
    received: list[float] = []
    lines: dict[str, int] = {}
    listed, live = 0, False
    for row in table_rows(file, COLUMNS, (REGISTERED, RECEIVED, ANSWER, SENT_AS), most_mb=FILES.recording_mb):
        live = REGISTERED in row.cells
        time_s, name = row.number("time_s"), row.text("marker")
        if times and time_s < times[-1]:
            message = f"time must not go back; {time_s:.9g} s at {_at(row)} follows {times[-1]:.9g} s"
            raise FormatError(message, where=row.where)
        if not times or time_s > times[-1]:
            listed = listed or len(first)
            times.append(time_s)
            frames.append({})
            taken.append(row.cells.get(REGISTERED, "1") != "0")
            answers.append(row.cells.get(ANSWER, ""))
            received.append(row.number(RECEIVED, may_miss=True) if RECEIVED in row.cells else np.nan)
            lines = {}
        if name in lines:
            message = f"each marker must stand once at one time; '{name}' at {_at(row)} is at line {lines[name]} too"
            raise FormatError(message, where=row.where)
        lines[name] = row.line
        first.setdefault(name, f"line {row.line}")
        frames[-1][name] = row.numbers(COLUMNS[2:], may_miss=True)
        check_room(len(frames), 3 * len(first), file)
    places = np.full((len(times), len(first), 3), np.nan)
    column = {name: i for i, name in enumerate(first)}
    for k, frame in enumerate(frames):
        for name, place in frame.items():
            places[k, column[name]] = place
    found = Tracks("table time_s,marker,x_mm,y_mm,z_mm", np.array(times), list(first), places)
    if live:
        found.registered, found.received, found.answers = np.array(taken), np.array(received), answers
    found.where, found.listed = list(first.values()), listed or len(first)
    return found


class TableRecorder:
    """Writes frames as they come to such a table, which takes its name when the block of `recorder` ends.

    `full` says that the table has its largest size; frames after that are not written.
    """

    def __init__(self, handle: io.RawIOBase, names: Sequence[str]) -> None:
        self.full = False
        self._handle, self._names, self._left = handle, names, 1_000_000 * FILES.recording_mb
        self._write([[*COLUMNS, REGISTERED, RECEIVED, ANSWER, SENT_AS]])

    def add(self, row: LiveRow) -> None:
        """Write a frame, its numbers to the last digit; raise `OSError` if there is no room for it."""
        told = [int(row.registered), repr(row.received_s), row.answer]
        rows = []
        for i, (name, place) in enumerate(zip(self._names, row.places.tolist(), strict=True)):
            sent_as = row.sent_as[i] if row.sent_as and row.sent_as[i] != name else ""
            numbers = ["" if isnan(x) else repr(x) for x in place]
            rows.append([repr(row.time_s), name, *numbers, *(told if i == 0 else ["", "", ""]), sent_as])
        self._write(rows)

    def _write(self, rows: Iterable[Sequence[object]]) -> None:
        """Write rows, all or none: a frame without some of its markers would be another frame."""
        lines = io.StringIO()
        csv.writer(lines, lineterminator="\n").writerows(rows)
        data = lines.getvalue().encode()
        self._left -= len(data)
        self.full = self.full or self._left < 0
        if self.full:
            return
        begin = self._handle.tell()
        try:
            while data:  # unbuffered: what is refused is known at once, and may have been written in part
                data = data[self._handle.write(data) or 0 :]
        except OSError:
            self._handle.truncate(begin)
            self._handle.seek(begin)  # there may be room again for the next one
            raise


@contextmanager
def recorder(path: Path, names: Sequence[str]) -> Iterator[TableRecorder]:
    """Yield what writes frames of markers to a table, whole or not at all; `names`: of the markers.

    A frame for which there is no room is left out; the table of those before it takes its name at the end.
    """
    with atomic_file(path) as draft, draft.open("wb", buffering=0) as handle:
        yield TableRecorder(handle, names)


def _at(row: Row) -> str:
    return f"{row.file} line {row.line}"
