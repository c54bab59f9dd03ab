"""Motion-capture files (.c3d): the 3-D points alone, of any processor, as whole numbers or floats.

Read here and not by a library: of the format, points need a header, a list of parameters and one array, and a reader of
our own refuses a broken file by an error that names it.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, bounded_stream
from tissuereg.io.recordings.tracks import HowRead, Tracks, check_room, is_place, unique, without_zeros


class _Format(NamedTuple):
    """Bytes of a block, the mark of the format, and the processor whose floats are its own."""

    block: int = 512
    mark: int = 0x50
    dec: int = 85


_C3D = _Format()


class _PointBlock(NamedTuple):
    """Where the points are: `start` byte, counts, `n_analog` numbers a frame, `scale` (negative: floats), `first`."""

    start: int
    n_frames: int
    n_points: int
    n_analog: int
    scale: float
    first: int
    rate: float


def is_c3d(head: bytes) -> bool:
    """Return whether a file begins as such a file: the number of a block, then the format's mark."""
    return len(head) > 1 and head[1] == _C3D.mark and head[0] in range(1, 128) and b"\0" in head[: _C3D.block]


def read_c3d(file: Path, how: HowRead) -> Tracks:
    """Return the points of a .c3d file; a negative residual is a place that was not measured."""
    with bounded_stream(file, FILES.recording_mb) as stream:
        data = stream.read()
    try:
        order, dec, parameters = _parameters(data)
        layout = _layout(data, order, dec, parameters)
        places = _places(data, order, dec, layout, file)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        message = f"{file} must be a whole .c3d file; {error}"
        raise FormatError(message, where=str(file)) from error
    units = _texts(parameters.get("POINT:UNITS"))
    mm = how.millimetres(units[0] if units and units[0] else None, file)
    labels = _labels(parameters)[: layout.n_points]
    names = unique([label or f"P{i + 1}" for i, label in enumerate([*labels, *[""] * (layout.n_points - len(labels))])])
    rate = layout.rate if np.isfinite(layout.rate) and layout.rate > 0.0 else how.rate_hz
    if rate is None:
        message = f"{file} states no rate: say how many frames a second with --rate (rate_hz=)"
        raise FormatError(message, where=str(file))
    screen = [one for one in _texts(parameters.get("POINT:Y_SCREEN")) if one[:1] == "+"]
    times = (layout.first - 1 + np.arange(layout.n_frames)) / rate
    places, notes = without_zeros(names, mm * places)
    return Tracks("C3D", times, names, places, up=screen[0][1:2].lower() if screen else None, notes=notes)


def _labels(parameters: Mapping[str, npt.NDArray[Any]]) -> list[str]:
    """Return the names of all points: a parameter holds 255 of them, and LABELS2, LABELS3 ... those that follow."""
    found, k = _texts(parameters.get("POINT:LABELS")), 2
    while f"POINT:LABELS{k}" in parameters:
        found += _texts(parameters[f"POINT:LABELS{k}"])
        k += 1
    return found


def _parameters(data: bytes) -> tuple[str, bool, dict[str, npt.NDArray[Any]]]:
    """Return byte order, whether floats are DEC's, and the parameters of all groups by ``GROUP:NAME``."""
    at = _C3D.block * (data[0] - 1)
    processor = data[at + 3]
    orders = {84: "<", _C3D.dec: "<", 86: ">"}
    if processor not in orders:
        message = f"the processor of a .c3d file must be one of {', '.join(map(str, orders))}, got {processor}"
        raise FormatError(message)
    order, dec = orders[processor], processor == _C3D.dec
    groups: dict[int, str] = {}
    found: list[tuple[int, str, npt.NDArray[Any]]] = []
    at += 4
    while True:
        length, group = struct.unpack_from("bb", data, at)
        if not length or not group:
            break
        name = data[at + 2 : at + 2 + abs(length)].decode("latin-1").strip().upper()
        at += 2 + abs(length)
        (step,) = struct.unpack_from(order + "h", data, at)
        if group < 0:
            groups[-group] = name
        else:
            found.append((group, name, _value(data, at + 2, order, dec)))
        if step <= 0:
            break
        at += step
    return order, dec, {f"{groups.get(group, '')}:{name}": value for group, name, value in found}


def _value(data: bytes, at: int, order: str, dec: bool) -> npt.NDArray[Any]:
    """Return a parameter's value at a place in the file, its first dimension the slowest."""
    kind, n_dims = struct.unpack_from("bB", data, at)
    shape = tuple(data[at + 2 : at + 2 + n_dims])[::-1]
    types = {-1: "S1", 1: "u1", 2: order + "i2", 4: order + "f4"}
    if kind not in types:
        return np.empty(0)
    raw = np.frombuffer(data, types[kind], int(np.prod(shape, dtype=np.int64)), at + 2 + n_dims)
    return (_from_dec(raw.view("<u2")) if dec and kind == 4 else raw).reshape(shape)


def _layout(data: bytes, order: str, dec: bool, parameters: Mapping[str, npt.NDArray[Any]]) -> _PointBlock:
    n_points, n_analog, first, last = struct.unpack_from(order + "4H", data, 2)
    (start,) = struct.unpack_from(order + "H", data, 16)
    scale, rate = (float(_floats(data[i : i + 4], order, dec)[0]) for i in (12, 20))
    n_frames = last - first + 1
    ends = [parameters.get(f"TRIAL:ACTUAL_{which}_FIELD") for which in ("START", "END")]
    if all(one is not None and one.dtype.kind == "i" and one.size == 2 for one in ends):
        first, last = (int(one.ravel().astype(np.uint16) @ np.array([1, 65536])) for one in ends if one is not None)
        n_frames = last - first + 1
    stated = parameters.get("POINT:RATE")
    rate = float(stated.ravel()[0]) if stated is not None and stated.size else rate
    if start < 2 or n_frames < 1 or not n_points or not np.isfinite(scale):
        message = f"a .c3d file must hold points in one frame or more, got {n_points} in {n_frames}, at block {start}"
        raise FormatError(message)
    return _PointBlock(_C3D.block * (start - 1), n_frames, n_points, n_analog, scale, max(first, 1), rate)


def _places(data: bytes, order: str, dec: bool, layout: _PointBlock, file: Path) -> FloatArray:
    """Return the places (n_frames, n_points, 3) in the file's unit, NaN where they were not measured."""
    floats = layout.scale < 0.0
    width = (4 if floats else 2) * (4 * layout.n_points + layout.n_analog)
    needed = layout.start + width * layout.n_frames
    if needed > len(data):
        message = f"{file} must hold {layout.n_frames} frames of {layout.n_points} points; it ends too early"
        raise FormatError(message, where=str(file))
    check_room(layout.n_frames, 4 * layout.n_points, file)
    raw = np.frombuffer(data, np.uint8, width * layout.n_frames, layout.start).reshape(layout.n_frames, width)
    part = np.ascontiguousarray(raw[:, : (16 if floats else 8) * layout.n_points])
    numbers = _floats(part.tobytes(), order, dec) if floats else part.view(order + "i2").astype(np.float64)
    numbers = numbers.reshape(layout.n_frames, layout.n_points, 4)
    places = numbers[..., :3] * (1.0 if floats else layout.scale)
    seen = (numbers[..., 3] >= 0.0) & is_place(places).all(axis=2)
    return np.where(seen[..., None], places, np.nan)


def _floats(raw: bytes, order: str, dec: bool) -> FloatArray:
    return _from_dec(np.frombuffer(raw, "<u2")) if dec else np.frombuffer(raw, order + "f4").astype(np.float64)


def _from_dec(words: "npt.NDArray[np.uint16]") -> FloatArray:
    """Return floats of a DEC processor: the two words of each exchanged, four times as large."""
    swapped = np.ascontiguousarray(words.reshape(-1, 2)[:, ::-1]).view("<f4").ravel()
    return swapped.astype(np.float64) / 4.0


def _texts(value: "npt.NDArray[Any] | None") -> list[str]:
    """Return the texts of a parameter of letters (n, length) or (length,); none if it is no such one."""
    if value is None or value.dtype.kind != "S" or not value.size:
        return []
    rows = value.reshape(-1, value.shape[-1]) if value.ndim else value.reshape(1, 1)
    return [row.tobytes().decode("latin-1").replace("\0", " ").strip() for row in rows]
