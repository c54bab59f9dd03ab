"""Messages of OpenIGTLink as bytes: header (versions 1 to 3), check sum, and the types that a live registration needs.

Written here and not taken from a library: the one in Python packs no values at the points of a surface, which carry the
spread of every node. Whatever comes in is checked before memory is taken for it; a message that breaks the protocol
raises `FormatError`. Lengths are in mm, times in s.
"""

import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError

_HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
_POINT = struct.Struct(">64s32s4B3ff20s")
_TOOL = struct.Struct(">20sBB12f")
_STATUS = struct.Struct(">Hq20s")
_COUNTS = struct.Struct(">10I")
_ATTRIBUTE = struct.Struct(">BBI")

#: Number of bytes of a header.
HEADER_BYTES = _HEADER.size


class ProtocolNumbers(NamedTuple):
    """Numbers that the protocol fixes, and how the check sum is computed.

    `polynomial`: of ECMA-182; `lane`: bytes that one lane of a long check sum goes through; `short`: bytes up to which
    it is computed one by one; `utf8`, `tool`: what the protocol calls UTF-8 and a tool of six degrees of freedom;
    `text`: most bytes of a text.
    """

    polynomial: int = 0x42F0E1EBA9EA3693
    lane: int = 256
    short: int = 1024
    utf8: int = 106
    tool: int = 2
    text: int = 65_535


_FIXED = ProtocolNumbers()


class MessageHeader(NamedTuple):
    """Header of a message: `time_s` is the sender's clock (0 = not stated), `size` the bytes of the body."""

    version: int
    type: str
    device: str
    time_s: float
    size: int
    crc: int


class Message(NamedTuple):
    """A message whose check sum is right: its header, its content, and what its sender added by name."""

    header: MessageHeader
    content: bytes
    metadata: Mapping[str, str]


class NamedPlace(NamedTuple):
    """A point of a message: `place` (3,), mm; `radius`, mm."""

    name: str
    place: FloatArray
    radius: float


class SurfaceData(NamedTuple):
    """A surface: `points` (n, 3), mm; `polygons`, each of node indices; `scalars`, values at the points by name."""

    points: FloatArray
    polygons: list[IntArray]
    scalars: dict[str, FloatArray]


class Status(NamedTuple):
    """A status: `code` 1 means OK; `name` and `text` say more."""

    code: int
    name: str
    text: str


# --- the envelope ---


def header_of(data: bytes) -> MessageHeader:
    """Return the header in the first bytes of a message; raise `FormatError` if it is none of versions 1 to 3."""
    if len(data) < HEADER_BYTES:
        message = f"a header must have {HEADER_BYTES} bytes, got {len(data)}"
        raise FormatError(message, where="header")
    version, type_, device, stamp, size, crc = _HEADER.unpack_from(data)
    if version not in (1, 2, 3):
        message = f"the version of a message must be 1, 2 or 3, got {version}"
        raise FormatError(message, where="header")
    return MessageHeader(version, _text(type_), _text(device), stamp / 2.0**32, size, crc)


def message_of(header: MessageHeader, body: bytes) -> Message:
    """Return a message of a header and its body; raise `FormatError` if the check sum or a length in it is wrong."""
    if len(body) != header.size or crc64(body) != header.crc:
        message = f"the body of a message must be whole and fit its check sum; a {header.type} does not"
        raise FormatError(message, where=header.type)
    if header.version == 1:
        return Message(header, body, {})
    if len(body) < _EXTENDED.size:
        message = f"a message of version {header.version} must have an extended header, got {len(body)} bytes"
        raise FormatError(message, where=header.type)
    begin, n_index, n_metadata, _ = _EXTENDED.unpack_from(body)
    end = len(body) - n_index - n_metadata
    if not _EXTENDED.size <= begin <= end:
        message = f"the parts of a message must fit into its {len(body)} bytes, got {begin}, {n_index}, {n_metadata}"
        raise FormatError(message, where=header.type)
    return Message(header, body[begin:end], _metadata(body[end:]))


def packed(
    type_: str, device: str, content: bytes, time_s: float = 0.0, metadata: Mapping[str, str] | None = None
) -> bytes:
    """Return the bytes of a message: of version 1, or 2 if it has metadata."""
    body = content if metadata is None else _with_metadata(content, metadata)
    stamp = int(max(time_s, 0.0) * 2.0**32) % 2**64
    version = 1 if metadata is None else 2
    return _HEADER.pack(version, type_.encode(), _named(device, 20), stamp, len(body), crc64(body)) + body


def crc64(data: bytes) -> int:
    """Return the 64-bit check sum of ECMA-182, as the protocol uses it.

    >>> hex(crc64(b"123456789"))
    '0x6c40df5f0b497347'
    """
    table = _table()
    if len(data) <= _FIXED.short:
        found, plain = 0, _plain_table()
        for byte in data:
            found = ((found << 8) & 0xFFFFFFFFFFFFFFFF) ^ plain[(found >> 56) ^ byte]
        return found
    # Zeros in front change nothing: lanes of equal length, all at once, then joined one after another.
    n_lanes = -(-len(data) // _FIXED.lane)
    padded = np.frombuffer(data.rjust(n_lanes * _FIXED.lane, b"\0"), np.uint8).reshape(n_lanes, -1)
    lanes = np.zeros(n_lanes, np.uint64)
    for column in np.ascontiguousarray(padded.T):
        lanes = (lanes << np.uint64(8)) ^ table[(lanes >> np.uint64(56)).astype(np.intp) ^ column]
    shift = _lane_shift()
    found = 0
    for lane in lanes.tolist():
        moved = 0
        for k in range(8):
            moved ^= shift[k][(found >> (8 * k)) & 0xFF]
        found = moved ^ lane
    return found


@lru_cache(maxsize=1)
def _plain_table() -> list[int]:
    found = []
    for byte in range(256):
        value = byte << 56
        for _ in range(8):
            value = ((value << 1) ^ (_FIXED.polynomial if value >> 63 else 0)) & 0xFFFFFFFFFFFFFFFF
        found.append(value)
    return found


@lru_cache(maxsize=1)
def _table() -> "npt.NDArray[np.uint64]":
    return np.array(_plain_table(), np.uint64)


@lru_cache(maxsize=1)
def _lane_shift() -> list[list[int]]:
    """Return what a lane of zeros makes of each byte at each of the eight places in a check sum."""
    values = np.arange(256, dtype=np.uint64)[None] << (8 * np.arange(8, dtype=np.uint64)[:, None])
    for _ in range(_FIXED.lane):
        values = (values << np.uint64(8)) ^ _table()[(values >> np.uint64(56)).astype(np.intp)]
    found: list[list[int]] = values.tolist()
    return found


def _metadata(data: bytes) -> dict[str, str]:
    """Return the metadata of a message by name; raise `FormatError` where a length in it is wrong."""
    if not data:
        return {}
    try:
        (count,) = struct.unpack_from(">H", data)
        sizes = [struct.unpack_from(">HHI", data, 2 + 8 * i) for i in range(count)]
    except struct.error as error:
        message = f"the metadata of a message must be whole: {error}"
        raise FormatError(message, where="metadata") from error
    at, found = 2 + 8 * count, {}
    for n_key, _, n_value in sizes:
        if at + n_key + n_value > len(data):
            message = f"the metadata of a message must fit into {len(data)} bytes"
            raise FormatError(message, where="metadata")
        key, value = data[at : at + n_key], data[at + n_key : at + n_key + n_value]
        found[key.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at += n_key + n_value
    return found


def _with_metadata(content: bytes, metadata: Mapping[str, str]) -> bytes:
    pairs = [(key.encode(), value.encode()) for key, value in metadata.items()]
    index = struct.pack(">H", len(pairs))
    index += b"".join(struct.pack(">HHI", len(key), _FIXED.utf8, len(value)) for key, value in pairs)
    data = b"".join(key + value for key, value in pairs)
    return _EXTENDED.pack(_EXTENDED.size, len(index), len(data), 0) + content + index + data


# --- what a tracker sends ---


def points_in(content: bytes) -> list[NamedPlace]:
    """Return the points of a POINT message."""
    found = []
    for name, _, *numbers in _records(_POINT, content, "POINT"):
        found.append(NamedPlace(_text(name), np.array(numbers[4:7], dtype=np.float64), float(numbers[7])))
    return found


def points_packed(points: Sequence[NamedPlace], group: str, colour: tuple[int, int, int, int]) -> bytes:
    """Return the content of a POINT message."""
    rows = [(_named(one.name, 64), _named(group, 32), *colour, *one.place.tolist(), one.radius, b"") for one in points]
    return b"".join(_POINT.pack(*row) for row in rows)


def transform_in(content: bytes) -> FloatArray:
    """Return the pose (4, 4) of a TRANSFORM message, mm."""
    if len(content) != 48:
        message = f"a TRANSFORM must have 48 bytes, got {len(content)}"
        raise FormatError(message, where="TRANSFORM")
    return _pose(struct.unpack(">12f", content))


def transform_packed(pose: FloatArray) -> bytes:
    """Return the content of a TRANSFORM message of a pose (4, 4), mm."""
    return struct.pack(">12f", *pose[:3].T.ravel().tolist())


def tools_in(content: bytes) -> dict[str, FloatArray]:
    """Return the poses (4, 4), mm, of the tools in a TDATA message, by name."""
    return {_text(name): _pose(numbers) for name, _, _, *numbers in _records(_TOOL, content, "TDATA")}


def tools_packed(poses: Mapping[str, FloatArray]) -> bytes:
    """Return the content of a TDATA message of tools with poses (4, 4), mm."""
    rows = [(_named(name, 20), _FIXED.tool, 0, *pose[:3].T.ravel().tolist()) for name, pose in poses.items()]
    return b"".join(_TOOL.pack(*row) for row in rows)


# --- what is answered ---


def text_in(content: bytes) -> str:
    """Return the text of a STRING message."""
    if len(content) < 4 or len(content) != 4 + struct.unpack_from(">H", content, 2)[0]:
        message = f"a STRING must be as long as it says, got {len(content)} bytes"
        raise FormatError(message, where="STRING")
    return content[4:].decode("utf-8", "replace")


def text_packed(text: str) -> bytes:
    """Return the content of a STRING message; raise `FormatError` if the text is longer than 65,535 bytes."""
    data = text.encode()
    if len(data) > _FIXED.text:
        message = f"a STRING must have at most {_FIXED.text} bytes, got {len(data)}"
        raise FormatError(message, where="STRING")
    return struct.pack(">HH", _FIXED.utf8, len(data)) + data


def status_in(content: bytes) -> Status:
    """Return the status of a STATUS message."""
    if len(content) < _STATUS.size:
        message = f"a STATUS must have {_STATUS.size} bytes or more, got {len(content)}"
        raise FormatError(message, where="STATUS")
    code, _, name = _STATUS.unpack_from(content)
    return Status(code, _text(name), _text(content[_STATUS.size :]))


def status_packed(status: Status) -> bytes:
    """Return the content of a STATUS message."""
    return _STATUS.pack(status.code, 0, _named(status.name, 20)) + status.text.encode() + b"\0"


def surface_in(content: bytes) -> SurfaceData:
    """Return the surface of a POLYDATA message: its points, polygons and scalars at the points."""
    if len(content) < _COUNTS.size:
        message = f"a POLYDATA must have {_COUNTS.size} bytes or more, got {len(content)}"
        raise FormatError(message, where="POLYDATA")
    n_points, _, n_vertices, _, n_lines, n_polygons, n_polygon_bytes, _, n_strips, n_attributes = _COUNTS.unpack_from(
        content
    )
    at = _COUNTS.size
    needed = at + 12 * n_points + n_vertices + n_lines + n_polygon_bytes + n_strips + _ATTRIBUTE.size * n_attributes
    if needed > len(content) or n_polygon_bytes % 4 or n_polygons > n_polygon_bytes // 4:
        message = f"the parts of a POLYDATA must fit into its {len(content)} bytes, they need {needed}"
        raise FormatError(message, where="POLYDATA")
    points = np.frombuffer(content, ">f4", 3 * n_points, at).astype(np.float64).reshape(-1, 3)
    at += 12 * n_points + n_vertices + n_lines
    words = np.frombuffer(content, ">u4", n_polygon_bytes // 4, at).astype(np.int64)
    at += n_polygon_bytes + n_strips
    return SurfaceData(points, _polygons(words, n_polygons, n_points), _scalars(content, at, n_attributes, n_points))


def surface_packed(points: FloatArray, triangles: IntArray, scalars: Mapping[str, FloatArray]) -> bytes:
    """Return the content of a POLYDATA message: points (n, 3), mm, triangles (m, 3), values (n,) at points by name."""
    cells = np.column_stack([np.full(len(triangles), 3), triangles]).astype(">u4").tobytes()
    counts = (len(points), 0, 0, 0, 0, len(triangles), len(cells), 0, 0, len(scalars))
    heads = b"".join(_ATTRIBUTE.pack(0, 1, len(values)) for values in scalars.values())
    names = b"".join(name.encode() + b"\0" for name in scalars)
    names += b"\0" * (len(names) % 2)
    data = b"".join(values.astype(">f4").tobytes() for values in scalars.values())
    return _COUNTS.pack(*counts) + points.astype(">f4").tobytes() + cells + heads + names + data


def _polygons(words: IntArray, count: int, n_points: int) -> list[IntArray]:
    found, at = [], 0
    for _ in range(count):
        n = int(words[at]) if at < len(words) else -1
        corners = words[at + 1 : at + 1 + n]
        if n < 0 or len(corners) != n or (corners >= n_points).any():
            message = "the polygons of a POLYDATA must be whole and of its points"
            raise FormatError(message, where="POLYDATA")
        found.append(corners)
        at += 1 + n
    return found


def _scalars(content: bytes, at: int, count: int, n_points: int) -> dict[str, FloatArray]:
    """Return the attributes of a POLYDATA that are one value a point, by name."""
    heads = [_ATTRIBUTE.unpack_from(content, at + _ATTRIBUTE.size * i) for i in range(count)]
    at += _ATTRIBUTE.size * count
    begin, names = at, []
    for _ in heads:
        end = content.find(b"\0", at)
        if end < 0:
            message = "the names in a POLYDATA must end with a zero"
            raise FormatError(message, where="POLYDATA")
        names.append(content[at:end].decode("utf-8", "replace"))
        at = end + 1
    at += (at - begin) % 2
    found = {}
    for (kind, width, n), name in zip(heads, names, strict=True):
        # Attributes of normals and tensors have three and nine components, whatever they say.
        size = n * {2: 3, 3: 9}.get(kind & 0x0F, max(width, 1))
        if at + 4 * size > len(content):
            message = f"the values in a POLYDATA must fit into its {len(content)} bytes"
            raise FormatError(message, where="POLYDATA")
        if size == n_points and kind == 0:
            found[name] = np.frombuffer(content, ">f4", size, at).astype(np.float64)
        at += 4 * size
    return found


def _records(layout: struct.Struct, content: bytes, type_: str) -> list[tuple[Any, ...]]:
    if len(content) % layout.size:
        message = f"a {type_} must have {layout.size} bytes for each part, got {len(content)}"
        raise FormatError(message, where=type_)
    return list(layout.iter_unpack(content))


def _pose(numbers: Sequence[float]) -> FloatArray:
    """Return the pose (4, 4) of twelve numbers, column after column."""
    pose = np.eye(4)
    pose[:3] = np.array(numbers, dtype=np.float64).reshape(4, 3).T
    return pose


def _text(raw: bytes) -> str:
    """Return what a sender calls something; it is shown in terminals, which what cannot be printed would command."""
    text = raw.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return "".join(one if one.isprintable() else "\ufffd" for one in text)


def _named(name: str, length: int) -> bytes:
    """Return a name as bytes that leave room for a zero at the end."""
    return name.encode()[: length - 1].decode("utf-8", "ignore").encode()
