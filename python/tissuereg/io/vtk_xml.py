"""VTK's XML files of unstructured grids (``.vtu``) and of polygons (``.vtp``), in one piece or several.

Arrays are text, base64 in place, or appended as base64 or raw bytes; packed by zlib, LZMA, LZ4 or not at all.
"""

import base64
import lzma
import re
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, too_large
from tissuereg.io.cursor import text_numbers
from tissuereg.io.grid import Block, Grid
from tissuereg.io.lz4 import unpacked_lz4
from tissuereg.io.notes import COMMENT
from tissuereg.io.vtk_cells import flat_blocks, vtk_blocks

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8", "String": "u1", "Bit": "u1",
}  # fmt: skip
_KINDS = ("UnstructuredGrid", "PolyData")
#: The lists of cells of polygonal data, and VTK's type for cells of any size.
_FLAT = {"Verts": 2, "Lines": 4, "Strips": 6, "Polys": 7}
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*_?")
_PADDED = re.compile(rb"[^=]+=*")
#: Bits of cell data that tell of a cell that another piece owns, or that is hidden; older files count its layer.
_GHOSTS = {"vtkGhostType": 1 | 32, "vtkGhostLevels": 255}


def read_vtk_xml(file: Path) -> Grid:
    """Return the content of a .vtu or .vtp file; its pieces follow one another.

    Point data that a piece lacks are 0 there if they are whole numbers or flags, or else NaN. Raises `FormatError` if
    the file is another kind of VTK file, or spoilt.
    """
    data = file.read_bytes()
    found = _APPENDED.search(data)
    text = data if found is None else data[: found.start()] + b"</VTKFile>"
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        message = f"{file} must be a VTK file, which declares no document type"
        raise FormatError(message)
    root = ElementTree.fromstring(text)
    kind = root.get("type", "")
    top = root.find(kind) if kind in _KINDS else None
    if root.tag != "VTKFile" or top is None:
        message = f"{file} must be a VTK file of {' or '.join(_KINDS)}; it is one of {kind or root.tag}"
        raise FormatError(message)
    arrays = _Arrays(file, root, found, data)
    pieces = [_piece(arrays, piece) for piece in top.findall("Piece")]
    notes = [one.decode("utf-8", "replace") for one in COMMENT.findall(text)]
    notes += [note for fields in top.iter("FieldData") for note in _notes(arrays, fields)]
    return _together([piece for piece in pieces if len(piece.points)], notes)


def _piece(arrays: "_Arrays", piece: Any) -> Grid:
    points = next((array for _, array in arrays.within(piece.find("Points"))), np.empty((0, 3)))
    if points.ndim != 2 or points.shape[1] != 3:
        message = f"points must have 3 coordinates, got an array of shape {points.shape}"
        raise FormatError(message)
    owned = piece.find("CellData")
    ghosts = [(mask, dict(arrays.within(owned, name)).get(name)) for name, mask in _GHOSTS.items()]
    cells = piece.find("Cells")
    blocks = _flat(arrays, piece, len(points)) if cells is None else _cells(arrays, cells, ghosts, len(points))
    data = {}
    for name, array in arrays.within(piece.find("PointData"), rows=len(points)):
        if len(array) != len(points):
            message = f"point data '{name}' must have {len(points)} rows, got {len(array)}"
            raise FormatError(message)
        data[name] = array
    return Grid(points.astype(np.float64), blocks, data)


def _cells(arrays: "_Arrays", cells: Any, ghosts: list[tuple[int, Any]], n_points: int) -> list[Block]:
    lists = dict(arrays.within(cells))
    if not {"types", "offsets", "connectivity"} <= set(lists):
        message = f"cells must have the arrays types, offsets and connectivity; got {', '.join(lists) or 'none'}"
        raise FormatError(message)
    types = lists["types"]
    for mask, hidden in ghosts:
        if hidden is not None and hidden.shape == types.shape and hidden.dtype.kind in "iu":
            types = np.where(hidden & mask, 0, types)
    return vtk_blocks(types, lists["offsets"], lists["connectivity"], n_points)


def _flat(arrays: "_Arrays", piece: Any, n_points: int) -> list[Block]:
    blocks = []
    for name, kind in _FLAT.items():
        lists = dict(arrays.within(piece.find(name)))
        if len(lists.get("offsets", ())):
            blocks += flat_blocks(kind, lists["offsets"], lists.get("connectivity", np.empty(0, np.int64)), n_points)
    return blocks


def _notes(arrays: "_Arrays", fields: Any) -> Iterator[str]:
    """Yield the texts among field data, as ``name=text``."""
    for element in fields:
        if element.get("type") == "String":
            codes = np.ravel(arrays.array(element)) & 255
            texts = codes.astype(np.uint8).tobytes().decode("utf-8", "replace").split("\0")
            yield from (f"{element.get('Name', '')}={text}" for text in texts if text)


def _together(pieces: list[Grid], notes: list[str]) -> Grid:
    if len(pieces) == 1:
        pieces[0].notes = notes
        return pieces[0]
    offsets = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    blocks = [
        replace(block, corners=block.corners + offset)
        for piece, offset in zip(pieces, offsets[:-1].tolist(), strict=True)
        for block in piece.blocks
    ]
    names = dict.fromkeys(name for piece in pieces for name in piece.point_data)
    data = {name: _column([(len(piece.points), piece.point_data.get(name)) for piece in pieces]) for name in names}
    points = np.concatenate([np.empty((0, 3)), *(piece.points for piece in pieces)])
    own = np.repeat(np.arange(len(pieces)), np.diff(offsets))
    known = {name: array for name, array in data.items() if array is not None}
    return Grid(points, blocks, known, notes=notes, pieces=own)


def _column(parts: list[tuple[int, npt.NDArray[Any] | None]]) -> npt.NDArray[Any] | None:
    """Join the rows of one name; None where the pieces have other shapes of row.

    Pieces without it get NaN, or 0 where it is whole numbers or marks points by 0 and 1.
    """
    given = [part for _, part in parts if part is not None]
    if len({part.shape[1:] for part in given}) != 1:
        return None
    kind, row = np.result_type(*given), given[0].shape[1:]
    empty = np.nan if kind.kind == "f" and not all(np.isin(part, (0, 1)).all() for part in given) else 0
    return np.concatenate([np.full((n, *row), empty, kind) if part is None else part for n, part in parts])


class _Arrays:
    """The arrays of one file; `appended` is the match of the tag behind which the bytes of appended ones stand."""

    def __init__(self, file: Path, root: Any, appended: "re.Match[bytes] | None", data: bytes) -> None:
        order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
        self._file, self._order = file, order
        self._header = np.dtype(order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
        self._unpack = _unpacker(root.get("compressor"))
        self._left = FILES.unpacked_mb * 1_000_000
        self._data, self._begin, self._raw = data, 0, False
        if appended is not None:
            self._begin, self._raw = appended.end(), b"raw" in appended[1]
        offsets = (_whole(e.get("offset", "0")) for e in root.iter() if e.get("format") == "appended")
        self._ends = sorted({*offsets, len(data) - self._begin})

    def within(self, parent: Any, only: str | None = None, rows: int = 0) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        """Yield names and arrays of numbers of an element, (n,) or (n, components); all, or those of one name.

        `rows`: how many there are of single bits, whose last byte may hold more.
        """
        for element in () if parent is None else parent:
            name = element.get("Name", "")
            if element.get("type") != "String" and only in (None, name):
                array, n = self.array(element), _whole(element.get("NumberOfComponents") or "1")
                array = array[: rows * n] if element.get("type") == "Bit" else array
                if n > 1 or parent.tag == "Points":
                    if n < 1 or array.size % n:
                        message = f"'{name}' must have {n} numbers a row, got {array.size} numbers"
                        raise FormatError(message)
                    array = array.reshape(-1, n)
                yield name, array

    def array(self, element: Any) -> npt.NDArray[Any]:
        """Return the numbers of an element, (n,)."""
        code, form = _TYPES.get(element.get("type", "")), element.get("format", "ascii")
        if code is None:
            message = f"an array must be of a type of {', '.join(_TYPES)}; '{element.get('Name')}' is {element.attrib}"
            raise FormatError(message)
        if form == "ascii":
            return text_numbers(element.text or "", code)
        if form == "appended":
            offset = _whole(element.get("offset", "0"))
            stop = next((end for end in self._ends if end > offset), offset)
            found = self._data[self._begin + offset : self._begin + stop]
            stream = found if self._raw else _from_base64(found.partition(b"<")[0])
        else:
            stream = _from_base64((element.text or "").encode("latin-1"))
        content = self._content(stream)
        dtype = np.dtype(self._order + code)
        if len(content) % dtype.itemsize:
            message = (
                f"'{element.get('Name')}' must be whole numbers of {dtype.itemsize} bytes, got {len(content)} bytes"
            )
            raise FormatError(message)
        numbers = np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))
        return np.unpackbits(numbers) if element.get("type") == "Bit" else numbers

    def _content(self, stream: bytes) -> bytes:
        """Return the bytes of an array: unpacked, without the sizes that stand before them."""
        if not stream:
            return b""
        step = self._header.itemsize
        if self._unpack is None:
            size = int(np.frombuffer(stream, self._header, 1)[0])
            return self._counted(stream[step : step + size], size)
        n_blocks = int(np.frombuffer(stream, self._header, 1)[0])
        if n_blocks == 0:
            return b""
        sizes = [int(size) for size in np.frombuffer(stream[: (n_blocks + 3) * step], self._header, n_blocks + 3)]
        _, whole, last, *packed = sizes
        at, parts = (n_blocks + 3) * step, []
        for number, length in enumerate(packed):
            size = last if number == n_blocks - 1 and last else whole
            if size > self._left:
                raise too_large(self._file, FILES.unpacked_mb, "unpacked it has more")
            parts.append(self._counted(self._unpack(stream[at : at + length], size), size))
            at += length
        return b"".join(parts)

    def _counted(self, found: bytes, size: int) -> bytes:
        if len(found) != size:
            message = f"an array must have {size} bytes, as it says; it has {len(found)}"
            raise FormatError(message)
        self._left -= size
        return found


def _whole(text: str) -> int:
    if not text.strip().isdecimal() or len(text) > 18:
        message = f"sizes must be whole numbers, got '{text[:40]}'"
        raise FormatError(message)
    return int(text)


def _from_base64(text: bytes) -> bytes:
    """Decode base64 in which several texts, each padded at its end, may follow one another."""
    parts = _PADDED.findall(text.translate(None, b" \t\r\n"))
    return b"".join(base64.b64decode(part, validate=True) for part in parts)


def _unpacker(name: str | None) -> Callable[[bytes, int], bytes] | None:
    """Return the function that unpacks a block of a compressor, given the size to which it unpacks; None for none."""
    if name is None:
        return None
    known = {
        "vtkZLibDataCompressor": lambda block, size: zlib.decompressobj().decompress(block, size + 1),
        "vtkLZMADataCompressor": lambda block, size: lzma.LZMADecompressor(memlimit=_LZMA_MEMORY).decompress(
            block, size + 1
        ),
        "vtkLZ4DataCompressor": unpacked_lz4,
    }
    if name not in known:
        message = f"a VTK file must be packed by one of {', '.join(known)}, or not; got {name}"
        raise FormatError(message)
    return known[name]


#: Memory that a block packed by LZMA may ask for, bytes: its strongest level needs 65 MiB.
_LZMA_MEMORY = 256 << 20
