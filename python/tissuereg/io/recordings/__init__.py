"""Recordings of trackers, one module for each format; each file is recognised by its content, not by its ending."""

import csv
import itertools
import os
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, named, place, real, text
from tissuereg._base.arrays import float_array, frozen
from tissuereg._base.provenance import reads
from tissuereg.errors import ArgumentError, FormatError, TissueRegError
from tissuereg.io.bounds import FILES, existing_file
from tissuereg.io.points import MM_PER_UNIT
from tissuereg.io.recordings.c3d import is_c3d, read_c3d
from tissuereg.io.recordings.columns import columns_in, read_columns
from tissuereg.io.recordings.motive import is_motive, read_motive
from tissuereg.io.recordings.ndi import is_ndi, read_ndi
from tissuereg.io.recordings.plus import is_plus, read_plus
from tissuereg.io.recordings.recording import ClockFault, Recording, checked_clock, clock_notes
from tissuereg.io.recordings.stitch import stitched
from tissuereg.io.recordings.table import COLUMNS, read_own_table
from tissuereg.io.recordings.tracks import HowRead, Tracks
from tissuereg.io.recordings.trc import is_trc, read_trc

_Reader = Callable[[Path, HowRead], Tracks]

#: What a reader raises at a file that is not what it begins as.
_SPOILT = (ValueError, KeyError, IndexError, OverflowError, struct.error, csv.Error, OSError)


@reads
def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: str | Mapping[str, str] | None = None,
    offsets: Mapping[str, Any] | None = None,
    rate_hz: float | None = None,
    unit: str | None = None,
) -> Recording:
    """Read a tracker's recording of markers; its format is recognised by its content.

    Parameters
    ----------
    path : path-like
        A table ``time_s,marker,x_mm,y_mm,z_mm``; a CSV export of OptiTrack Motive or of an NDI tracker; a sequence of
        PLUS (``.igs.mha``, ``.seq.mha``); a ``.c3d`` or ``.trc`` file; or any other table, with `columns`.
    columns : str or mapping of str to str, optional
        What the columns of another table hold: ``time`` (or ``frame``, with `rate_hz`), ``x``, ``y``, ``z``, ``marker``
        if each row is one marker's; ``NAME.x`` and so on if a row holds several; ``unit`` (mm, cm, m),
        ``time_unit`` (s, ms, us, ns). As a text: ``"time=Time (Seconds) x=X y=Y z=Z unit=mm"``.
    offsets : mapping of str to array_like of float, shape (3,), optional
        Place of the marker on each tool in the tool's own coordinates, by its name, mm. A tool without one is a marker
        at its origin.
    rate_hz : float, optional
        Frames a second, for a file that numbers its frames and states no times.
    unit : {"mm", "cm", "m", "um", "nm"}, optional
        Unit of length of a file that states none.

    Returns
    -------
    Recording
        Times in s, names, and places in mm; what is missing is NaN. Frames whose times do not advance are left out, and
        told in `clock` and `notes`.

    Raises
    ------
    FormatError
        If the file cannot be read, its format is none of these, or it does not say what must be given.
    ArgumentError, ShapeError
        If an argument has the wrong type or is out of its range.
    """
    file = place("path", path, error=FormatError)
    how = HowRead(_columns(columns), _offsets(offsets), _rate(rate_hz), unit)
    if unit is not None:
        check_choice("unit", unit, tuple(MM_PER_UNIT), ArgumentError)
    try:
        existing_file(file)
        read = read_columns if how.columns else _reader_of(file)
        with np.errstate(over="ignore", invalid="ignore"):
            return _recording(file, read(file, how))
    except TissueRegError as error:
        error.where = error.where or str(file)
        raise
    except _SPOILT as error:
        message = f"{file} cannot be read as a recording: {' '.join(str(error).split())}"
        raise FormatError(message, where=str(file)) from error


def _recording(file: Path, tracks: Tracks) -> Recording:
    """Return what a reader found, its clock checked and its unlabelled tracks joined."""
    kept, faults = checked_clock(tracks.times)
    far = np.asarray((np.abs(tracks.places) >= FILES.farthest_mm).any(axis=2))
    if far.any():
        tracks.notes.append(f"{int(far.sum())} places farther away than a kilometre are no measurements: not seen")
        tracks.places = np.where(far[..., None], np.nan, tracks.places)
    names, places, notes, numbered = stitched(tracks.names, tracks.places[kept], tracks.unlabelled)
    std = None if tracks.std is None or names != tracks.names else tracks.std[kept]
    live = None if tracks.registered is None else tracks.registered[kept]
    received = None if tracks.received is None else frozen(tracks.received[kept])
    answers = None if tracks.answers is None else tuple(itertools.compress(tracks.answers, kept))
    return Recording(
        frozen(np.ascontiguousarray(tracks.times[kept])),
        tuple(names),
        frozen(np.ascontiguousarray(places)),
        std,
        tracks.up,
        tracks.format,
        faults,
        (*tracks.notes, *notes, *clock_notes(faults)),
        live,
        str(file),
        tuple(tracks.where),
        len(names) if tracks.listed is None else tracks.listed,
        received,
        answers,
        numbered,
    )


def _reader_of(file: Path) -> _Reader:
    """Return the reader of a file, by its first bytes."""
    with file.open("rb") as stream:
        head = stream.read(FILES.head_bytes)
    if is_c3d(head):
        return read_c3d
    if is_plus(head):
        return read_plus
    words = head.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    for fits, reader in ((is_trc, read_trc), (is_motive, read_motive), (is_ndi, read_ndi)):
        if fits(words):
            return reader
    first = next((line for line in words.splitlines() if line.strip()), "")
    if "time_s" in first and "marker" in first:
        return read_own_table
    message = (
        f"{file} must be a table with the header {','.join(COLUMNS)}, an export of Motive or NDI, a sequence of PLUS, "
        f"a .c3d or .trc file; it begins '{first[:60]}': name the columns of other tables with --columns (columns=)"
    )
    raise FormatError(message, where=str(file))


def _columns(columns: Any) -> Mapping[str, str]:
    if columns is None:
        return {}
    if isinstance(columns, str):
        return columns_in(columns)
    return {key: text("columns", value) for key, value in named("columns", columns).items()}


def _offsets(offsets: Any) -> dict[str, Any]:
    given = {} if offsets is None else named("offsets", offsets)
    return {name: float_array("offsets", value, (3,)) for name, value in given.items()}


def _rate(rate_hz: Any) -> float | None:
    return None if rate_hz is None else real("rate_hz", rate_hz, above=0.0, unit="1/s")


__all__ = ["ClockFault", "Recording", "read_recording"]
