"""What readers of recordings share: how a file is to be read, what it held, poses of tools, bounded lines of text."""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, bounded_stream, too_large
from tissuereg.io.points import MM_PER_UNIT

#: Millimetres in a unit of length by the words that trackers write, in lower case.
_WORDS = {"millimeters": "mm", "millimetres": "mm", "centimeters": "cm", "centimetres": "cm", "meters": "m"}
_WORDS |= {"metres": "m", "millimeter": "mm", "centimeter": "cm", "meter": "m"}


def is_place(values: FloatArray) -> BoolArray:
    """Return whether numbers may be coordinates in any unit, or times in s: trackers write huge ones for none."""
    return np.asarray(np.abs(values) < FILES.farthest)


@dataclass(frozen=True)
class HowRead:
    """What the caller says of a file that the file does not say itself.

    `columns`: columns of a table by what they hold; `offsets`: place of the marker on each tool, by its name, mm;
    `rate_hz`: frames a second; `unit`: unit of length.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, FloatArray] = field(default_factory=dict)
    rate_hz: float | None = None
    unit: str | None = None

    def millimetres(self, stated: str | None, file: Path) -> float:
        """Return the millimetres in the unit that a file states, or else the caller; refuse where they differ."""
        own = None if stated is None else _WORDS.get(stated.strip().lower(), stated.strip().lower())
        if own is not None and own not in MM_PER_UNIT:
            message = f"the unit of {file} must be one of {', '.join(MM_PER_UNIT)}, got '{stated}'"
            raise FormatError(message, where=str(file))
        if own is None and self.unit is None:
            message = f"{file} states no unit of length: say it with --unit (unit= in Python), mm, cm or m"
            raise FormatError(message, where=str(file))
        if own is not None and self.unit not in (None, own):
            message = f"{file} states the unit {own}; {self.unit} contradicts it: leave it out"
            raise FormatError(message, where=str(file))
        return MM_PER_UNIT[own or str(self.unit)]

    def times_of(self, frames: FloatArray, file: Path, hint: str) -> FloatArray:
        """Return times, s, from numbers of frames by the rate that the caller gave; `hint`: usual rates, in words."""
        if self.rate_hz is None:
            message = (
                f"{file} numbers its frames and states no times: say how many a second with --rate (rate_hz=); {hint}"
            )
            raise FormatError(message, where=str(file))
        return np.asarray(frames / self.rate_hz)


@dataclass
class Tracks:
    """What a file held, before its clock is checked and its unlabelled tracks are joined.

    `times` (n_frames,), s; `names`: of each track; `places` (n_frames, n_tracks, 3), mm, NaN where missing; `std`
    (n_frames, n_tracks), mm, or None; `unlabelled`: tracks whose names the tracker made up; `where`: where each name
    stands first, if the reference must name all; `listed`: tracks in the first frame, None for all; others as in
    `Recording`.
    """

    format: str
    times: FloatArray
    names: list[str]
    places: FloatArray
    std: FloatArray | None = None
    up: str | None = None
    notes: list[str] = field(default_factory=list)
    unlabelled: set[str] = field(default_factory=set)
    registered: BoolArray | None = None
    received: FloatArray | None = None
    answers: list[str] | None = None
    where: list[str] = field(default_factory=list)
    listed: int | None = None


def rows_of(file: Path, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Yield number and stripped cells of each line of a table that is not empty; reading stops at a bound.

    Trackers write names and dates in any code: a letter that is no UTF-8 becomes a sign that says so.
    """
    stream = bounded_stream(file, FILES.recording_mb)
    with io.TextIOWrapper(stream, encoding="utf-8-sig", errors="replace", newline="") as handle:
        reader = csv.reader(handle, delimiter=delimiter, strict=True)
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                yield reader.line_num, cells


def check_room(n_frames: int, n_numbers: int, file: Path) -> None:
    """Raise `FormatError` where frames of so many numbers would take more memory than arrays of a file may."""
    needed = 8e-6 * n_frames * n_numbers
    if needed > FILES.unpacked_mb:
        raise too_large(file, FILES.unpacked_mb, f"its numbers take {needed:.0f} MB or more")


def number_in(text: str, file: Path, line: int) -> float:
    """Return the number in a cell, NaN if it is empty or beyond all places; raise `FormatError` if it is none."""
    if not text or text.lower() == "nan":
        return math.nan
    try:
        value = math.inf if "_" in text else float(text)  # Python alone takes 1_000 for a number
    except ValueError:
        value = math.inf
    if math.isinf(value):
        message = f"a cell must hold a finite number or nothing, got '{text[:40]}' at {file} line {line}"
        raise FormatError(message, where=f"{file}:{line}")
    return value if abs(value) < FILES.farthest else math.nan


def unique(names: Sequence[str]) -> list[str]:
    """Return names, the second of two equal ones followed by a word: by number it is the first's rival, not another."""
    found: dict[str, None] = {}
    for name in names:
        given = name
        while given in found:
            given += " (again)"
        found[given] = None
    return list(found)


def rotations(quaternions: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) of quaternions (..., 4), the scalar first, of any length; NaN where it is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def tool_places(turns: FloatArray | None, origins: FloatArray, offset: FloatArray | None) -> FloatArray:
    """Return where the marker of a tool is (n, 3), mm, from poses: `turns` (n, 3, 3), `origins` (n, 3), mm.

    `offset` (3,): its place on the tool, mm; None for the tool's origin.
    """
    if offset is None or not offset.any():
        return origins
    if turns is None:
        message = "an offset needs orientations as quaternions; the file has none"
        raise FormatError(message)
    return np.asarray(origins + turns @ offset)


def offset_notes(tools: Sequence[str], offsets: Mapping[str, FloatArray]) -> list[str]:
    """Return a note on tools that count at their origins; raise `FormatError` at an offset of no tool."""
    strangers = [name for name in offsets if name not in tools]
    if strangers:
        message = f"an offset must be of a tool of the file ({', '.join(tools) or 'it has none'}), got '{strangers[0]}'"
        raise FormatError(message)
    plain = [name for name in tools if name not in offsets]
    return [f"tools whose origins are the markers, for want of an offset: {', '.join(plain)}"] if plain else []


def without_zeros(names: Sequence[str], places: FloatArray) -> tuple[FloatArray, list[str]]:
    """Return places (n_frames, n, 3) with those that are exactly 0, 0, 0 as NaN, and notes: some write it for none."""
    none = (places == 0.0).all(axis=2)
    notes = [
        f"{name} is at 0, 0, 0 in {count} frames and counts as not seen there"
        for name, count in zip(names, none.sum(axis=0).tolist(), strict=True)
        if count
    ]
    return np.where(none[..., None], np.nan, places), notes


def without_repeats(places: FloatArray) -> tuple[FloatArray, int]:
    """Return poses (n, d) with those that repeat the one before to the last digit as NaN, and how many these are."""
    seen = np.isfinite(places).all(axis=1)
    rows = np.flatnonzero(seen)
    same = rows[1:][(places[rows[1:]] == places[rows[:-1]]).all(axis=1)]
    fresh = places.copy()
    fresh[same] = np.nan
    return fresh, len(same)
