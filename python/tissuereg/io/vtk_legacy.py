"""VTK's legacy files (``.vtk``) of unstructured grids and of polygons, versions 1 to 5, text or binary."""

from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from tissuereg.errors import FormatError
from tissuereg.io.cursor import Cursor
from tissuereg.io.grid import Block, Grid
from tissuereg.io.vtk_cells import flat_blocks, vtk_blocks

#: Numbers by the names of VTK's types. An id takes four bytes, whatever it took in memory.
_TYPES = {
    "char": "i1", "signed_char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4",
    "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "long_long": "i8", "unsigned_long_long": "u8",
    "__int64": "i8", "unsigned___int64": "u8", "vtktypeint8": "i1", "vtktypeuint8": "u1", "vtktypeint16": "i2",
    "vtktypeuint16": "u2", "vtktypeint32": "i4", "vtktypeuint32": "u4", "vtktypeint64": "i8", "vtktypeuint64": "u8",
    "vtkidtype": "i4", "float": "f4", "double": "f8", "vtktypefloat32": "f4", "vtktypefloat64": "f8",
}  # fmt: skip
#: Types of four bytes where Windows wrote the file, and of eight elsewhere.
_WINDOWS = ("long", "unsigned_long")
_TEXTS = ("string", "utf8_string")
_FLAT = {"VERTICES": 2, "LINES": 4, "TRIANGLE_STRIPS": 6, "POLYGONS": 7}
_LISTS = ("CELLS", *_FLAT)
#: Numbers a row of point data of each keyword; the others say it themselves.
_WIDTHS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}


def read_vtk_legacy(file: Path) -> Grid:
    """Return the content of a legacy .vtk file.

    Raises `FormatError` if it is of another kind than unstructured grid or polygons, or is spoilt.
    """
    return _Reader(file.read_bytes()).grid()


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._file = Cursor(data, order=">")
        head = [self._file.line() for _ in range(3)]
        if head[2].upper() not in ("ASCII", "BINARY"):
            message = f"line 3 must be ASCII or BINARY, got '{head[2][:40]}'"
            raise FormatError(message)
        self._file.binary = head[2].upper() == "BINARY"
        self._notes = [head[1]]
        self._points: npt.NDArray[Any] = np.empty((0, 3))
        self._lists: dict[str, tuple[npt.NDArray[Any], npt.NDArray[Any]]] = {}
        self._types: npt.NDArray[Any] = np.empty(0, np.int64)
        self._data: dict[str, npt.NDArray[Any]] = {}
        #: Number of rows of point or cell data; the latter are not kept.
        self._rows, self._of_points = 0, False

    def grid(self) -> Grid:
        while words := self._file.words():
            self._section(words[0].upper(), words)
        blocks = []
        for name, (ends, joined) in self._lists.items():
            blocks += self._blocks(name, ends, joined)
        wrong = [name for name, array in self._data.items() if len(array) != len(self._points)]
        if wrong:
            message = (
                f"point data must have {len(self._points)} rows, as many as points; '{wrong[0]}' has another number"
            )
            raise FormatError(message)
        return Grid(self._points.astype(np.float64), blocks, self._data, notes=self._notes)

    def _blocks(self, name: str, ends: Any, joined: Any) -> list[Block]:
        if name == "CELLS":
            return vtk_blocks(self._types, ends, joined, len(self._points))
        return flat_blocks(_FLAT[name], ends, joined, len(self._points))

    def _section(self, key: str, words: list[str]) -> None:
        if key == "DATASET":
            kind = _word(words, 1).upper()
            if kind not in ("UNSTRUCTURED_GRID", "POLYDATA"):
                message = f"a .vtk file must hold an UNSTRUCTURED_GRID or POLYDATA, got {kind}"
                raise FormatError(message)
        elif key == "POINTS":
            self._points = self._numbers(_word(words, 2), 3 * _count(words, 1)).reshape(-1, 3)
        elif key in _LISTS:
            self._lists[key] = self._cells(_count(words, 1), _count(words, 2))
        elif key == "CELL_TYPES":
            self._types = self._numbers("int", _count(words, 1))
        elif key in ("POINT_DATA", "CELL_DATA"):
            self._rows, self._of_points = _count(words, 1), key == "POINT_DATA"
        elif key == "METADATA":
            self._skip_metadata()
        elif key == "FIELD":
            for _ in range(_count(words, 2)):
                self._field(self._file.words())
        else:
            self._attribute(key, words)

    def _cells(self, first: int, second: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return where each cell ends, and all cells' points; `first`, `second`: the numbers behind the keyword."""
        if self._file.next_word().upper() == "OFFSETS":
            offsets = self._numbers(_word(self._file.words(), 1), first)
            return offsets[1:], self._numbers(_word(self._file.words(), 1), second)
        rows = self._numbers("int", second)
        sizes, at = np.empty(min(first, second), np.int64), 0
        regular = _regular(rows, first)
        if regular is not None:
            return regular
        for cell in range(len(sizes)):
            if at >= len(rows) or rows[at] < 0:
                break
            sizes[cell] = rows[at]
            at += int(rows[at]) + 1
        if first > second or at != second:
            message = f"{first} cells must take {second} numbers, each its size and its points; they do not"
            raise FormatError(message)
        heads = np.concatenate([[0], np.cumsum(sizes + 1)])[:-1]
        return np.cumsum(sizes), np.delete(rows, heads)

    def _attribute(self, key: str, words: list[str]) -> None:
        if key == "SCALARS":
            width = _count(words, 3) if len(words) > 3 else 1
            if self._file.next_word().upper() == "LOOKUP_TABLE":
                self._file.words()
            self._keep(_word(words, 1), self._numbers(_word(words, 2), width * self._rows), width)
        elif key == "COLOR_SCALARS":
            width = _count(words, 2)
            self._numbers("unsigned_char" if self._file.binary else "float", width * self._rows)
        elif key == "LOOKUP_TABLE":
            self._numbers("unsigned_char" if self._file.binary else "float", 4 * _count(words, 2))
        elif key == "TEXTURE_COORDINATES":
            self._numbers(_word(words, 3), _count(words, 2) * self._rows)
        elif key in _WIDTHS:
            self._keep(_word(words, 1), self._numbers(_word(words, 2), _WIDTHS[key] * self._rows), _WIDTHS[key])
        else:
            message = f"a section must begin with a keyword of VTK, got '{words[0][:40]}'"
            raise FormatError(message)

    def _skip_metadata(self) -> None:
        while self._file.line():  # ends with an empty line
            pass

    def _field(self, words: list[str]) -> None:
        while words == ["METADATA"]:  # of the array before
            self._skip_metadata()
            words = self._file.words()
        name, width, rows, kind = unquote(_word(words, 0)), _count(words, 1), _count(words, 2), _word(words, 3)
        if kind.lower() in _TEXTS:
            texts = [self._text() for _ in range(self._possible(width * rows))]
            self._notes += [f"{name}={text}" for text in texts] if self._rows == 0 else []
        else:
            self._keep(name, self._numbers(kind, width * rows), width)

    def _text(self) -> str:
        """Return one text of an array of texts: a line, or bytes after their number in 6, 14, 30 or 62 bits."""
        if not self._file.binary:
            return unquote(self._file.line())
        first = self._file.one("u1")
        n_more = (7, 3, 1, 0)[first >> 6]
        more = self._file.numbers("u1", n_more).tolist()
        length = int.from_bytes(bytes([first & 63, *more]), "big")
        return self._file.numbers("u1", length).tobytes().decode("utf-8", "replace")

    def _possible(self, n_texts: int) -> int:
        """Return a number of texts, each of which takes at least a byte."""
        if n_texts > len(self._file.data) - self._file.at:
            message = f"the file ends too early: {n_texts} texts must follow"
            raise FormatError(message)
        return n_texts

    def _keep(self, name: str, numbers: npt.NDArray[Any], width: int) -> None:
        if self._of_points and numbers.size:
            self._data[unquote(name)] = numbers.reshape(-1, width) if width > 1 else numbers

    def _numbers(self, kind: str, count: int) -> npt.NDArray[Any]:
        file, kind = self._file, kind.lower()
        if kind == "bit":
            packed = file.numbers("u1", (count + 7) // 8 if file.binary else count)
            return np.unpackbits(packed, count=count) if file.binary else packed
        if kind not in _TYPES:
            message = f"numbers must be of a type that VTK knows, got '{kind[:40]}'"
            raise FormatError(message)
        code = _TYPES[kind]
        if file.binary and kind in _WINDOWS and self._line_ends(4 * count) and not self._line_ends(8 * count):
            code = code[0] + "4"
        return file.numbers(code, count)

    def _line_ends(self, n_bytes: int) -> bool:
        """Return whether the file, or a line, ends after the next bytes."""
        rest = self._file.data[self._file.at + n_bytes : self._file.at + n_bytes + 1]
        return self._file.at + n_bytes <= len(self._file.data) and rest in b"\r\n"


def _regular(rows: npt.NDArray[Any], n_cells: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]] | None:
    """Return ends and points of cells that all have one size, as most files have them; None for others."""
    if n_cells == 0 or len(rows) % n_cells:
        return None
    table = rows.reshape(n_cells, -1)
    size = table.shape[1] - 1
    if size < 1 or (table[:, 0] != size).any():
        return None
    return np.arange(1, n_cells + 1) * size, table[:, 1:].ravel()


def _word(words: list[str], place: int) -> str:
    if place >= len(words):
        message = f"a line must have {place + 1} words or more, got '{' '.join(words)[:60]}'"
        raise FormatError(message)
    return words[place]


def _count(words: list[str], place: int) -> int:
    text = _word(words, place)
    if not text.isdecimal() or len(text) > 18:
        message = f"a count must be a whole number, got '{text[:40]}' in '{' '.join(words)[:60]}'"
        raise FormatError(message)
    return int(text)
