"""Surfaces in ``.ply`` (polygon file format), text or binary of either byte order: vertices, faces, other elements."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.polygons import cut, cut_listed

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_END = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(?:\r\n|\n|\r)")


@dataclass
class _Property:
    """A value of every row of an element: its name and type; `length`: type of the number before a list of values."""

    name: str
    kind: str
    length: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(file: Path) -> tuple[FloatArray, IntArray, list[str]]:
    """Return the vertices (n, 3) of a .ply, its faces as triangles (m, 3), and its comments.

    `file`: an existing .ply. Raises `FormatError` if its header is spoilt, or it does not hold what its header says.
    """
    data = file.read_bytes().removeprefix(b"\xef\xbb\xbf")
    try:
        order, elements, notes, begin = _header(data)
        stream = _Stream(data[begin:], order)
        rows = {element.name: stream.rows(element) for element in elements}
        stream.end()
        vertices = np.column_stack([np.asarray(rows["vertex"][axis], np.float64) for axis in "xyz"])
        corners = next((_indices(rows["face"][name]) for name in _CORNERS if name in rows.get("face", {})), None)
    except KeyError as error:
        message = f"{file} must have elements 'vertex' with x, y, z; {error} is missing"
        raise FormatError(message, where=str(file)) from error
    except (ValueError, OverflowError) as error:
        message = f"{file} must be a whole .ply: {error}"
        raise FormatError(message, where=str(file)) from error
    if corners is None:
        message = f"{file} must hold the faces of a surface, with vertex_indices; it has {', '.join(rows)}"
        raise FormatError(message, where=str(file))
    return vertices, cut_listed(vertices, corners) if isinstance(corners, list) else cut(vertices, corners), notes


def _indices(lists: Any) -> Any:
    """Return numbers (k, c), or lists of numbers, as whole ones."""
    if isinstance(lists, list):
        return [_indices(np.array(one)).tolist() for one in lists]
    with np.errstate(invalid="ignore"):
        whole = np.asarray(lists).astype(np.int64)
    if not np.array_equal(whole, lists):
        message = "the vertices of a face are no whole numbers"
        raise ValueError(message)
    return whole


def _header(data: bytes) -> tuple[str, list[_Element], list[str], int]:
    """Return byte order, empty for text, elements, comments, and where the content begins."""
    end = _END.search(data)
    if end is None:
        message = "its header does not end"
        raise ValueError(message)
    order, elements, notes = None, [], []
    for line in re.split("\r\n|\n|\r", data[: end.start()].decode("latin-1")):
        match line.split():
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= set(_TYPES):
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["comment" | "obj_info", *_]:
                notes.append(line)
            case [] | ["ply"]:
                pass
            case _:
                message = f"its header holds '{line[:60]}'"
                raise ValueError(message)
    if order is None or not all(element.properties for element in elements):
        message = "its header states no format, or an element without properties"
        raise ValueError(message)
    return order, elements, notes, end.end()


class _Stream:
    """The content behind the header, read element by element: numbers of a text, or bytes."""

    def __init__(self, data: bytes, order: str) -> None:
        self._order = order
        self._data: npt.NDArray[Any] = np.frombuffer(data, np.uint8) if order else np.array(data.split(), np.float64)
        self._at = 0

    def rows(self, element: _Element) -> dict[str, Any]:
        """Return the values of each property: (count,) numbers, (count, k) for lists of one length, or else lists."""
        lengths = self._first_lengths(element) if element.count else [0] * len(element.properties)
        row = self._type(element, lengths)
        taken = self._taken(row, element.count)
        if taken is not None:
            lists = [one for one in element.properties if one.length]
            if all((taken["n " + one.name] == taken[one.name].shape[1]).all() for one in lists):
                self._at += element.count * self._width(row)
                return {one.name: taken[one.name] for one in element.properties}
        found: dict[str, list[Any]] = {one.name: [] for one in element.properties}
        for _ in range(element.count):
            for one in element.properties:
                length = int(self._numbers(one.length, 1)[0]) if one.length else 1
                values = self._numbers(one.kind, length)
                found[one.name].append(values.tolist() if one.length else values[0])
        return found

    def end(self) -> None:
        """Raise `ValueError` if more follows than the header says."""
        rest = self._data[self._at :]
        if len(rest.tobytes().strip() if self._order else rest):
            message = "more follows than its header says"
            raise ValueError(message)

    def _first_lengths(self, element: _Element) -> list[int]:
        """Return the number of values of each property in the next row, without moving on."""
        begin, lengths = self._at, []
        for one in element.properties:
            length = int(self._numbers(one.length, 1)[0]) if one.length else 1
            self._numbers(one.kind, length)
            lengths.append(length)
        self._at = begin
        return lengths

    def _type(self, element: _Element, lengths: list[int]) -> np.dtype[Any]:
        columns: list[Any] = []
        for one, length in zip(element.properties, lengths, strict=True):
            kind, before = (self._order + (k or "u1") if self._order else "f8" for k in (one.kind, one.length))
            columns += [("n " + one.name, before), (one.name, kind, (length,))] if one.length else [(one.name, kind)]
        return np.dtype(columns)

    def _width(self, row: np.dtype[Any]) -> int:
        return row.itemsize if self._order else row.itemsize // 8

    def _taken(self, row: np.dtype[Any], count: int) -> npt.NDArray[Any] | None:
        """Return the next rows as they are if all were of one type; None if that would be too long."""
        stop = self._at + count * self._width(row)
        return self._data[self._at : stop].view(row) if stop <= len(self._data) and row.itemsize else None

    def _numbers(self, kind: str, count: int) -> npt.NDArray[Any]:
        width = int(kind[1]) if self._order else 1
        stop = self._at + count * width
        if count < 0 or stop > len(self._data):
            message = "it ends before its header says"
            raise ValueError(message)
        found = self._data[self._at : stop]
        self._at = stop
        return found.view(self._order + kind) if self._order else found
