"""Gmsh's mesh files (``.msh``), versions 2 and 4.1, text or binary.

Physical groups become node sets: by their names, or else as ``surface_7`` for the physical surface 7.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import IntArray
from tissuereg.errors import FormatError
from tissuereg.io.cursor import Cursor
from tissuereg.io.grid import CELLS, Block, Grid, checked_corners

_DIMENSIONS = ("point", "curve", "surface", "volume")

#: Kind and number of nodes of each element type; the corners come first.
_TYPES = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4), 4: ("tetra", 4), 5: ("hexahedron", 8), 6: ("wedge", 6),
    7: ("pyramid", 5), 8: ("line", 3), 9: ("triangle", 6), 10: ("quad", 9), 11: ("tetra", 10), 12: ("hexahedron", 27),
    13: ("wedge", 18), 14: ("pyramid", 14), 15: ("vertex", 1), 16: ("quad", 8), 17: ("hexahedron", 20),
    18: ("wedge", 15), 19: ("pyramid", 13), 20: ("triangle", 9), 21: ("triangle", 10), 22: ("triangle", 12),
    23: ("triangle", 15), 24: ("triangle", 15), 25: ("triangle", 21), 26: ("line", 4), 27: ("line", 5), 28: ("line", 6),
    29: ("tetra", 20), 30: ("tetra", 35), 31: ("tetra", 56), 36: ("quad", 16), 37: ("quad", 25), 38: ("quad", 36),
    92: ("hexahedron", 64), 93: ("hexahedron", 125),
}  # fmt: skip
_NAME = re.compile(r'\s*(\d+)\s+(-?\d+)\s+"(.*)"\s*')
_EMPTY_GROUP = 0
_MOST_TEXTS = 9


def read_gmsh(file: Path) -> Grid:
    """Return the content of a .msh file.

    Raises `FormatError` if it is of another version, or is spoilt.
    """
    return _Reader(file.read_bytes()).grid()


class _Reader:
    """Reader of one file. `_elements`: dimension, physical groups, type and node tags (n, k) of elements."""

    def __init__(self, data: bytes) -> None:
        self._file = Cursor(data)
        self._version = 0.0
        self._size = "u8"
        self._notes: list[str] = []
        self._names: dict[tuple[int, int], str] = {}
        self._groups: dict[tuple[int, int], list[int]] = {}
        self._tags: list[IntArray] = []
        self._points: list[npt.NDArray[Any]] = []
        self._elements: list[tuple[list[int], int, IntArray]] = []
        self._data: dict[str, tuple[IntArray, npt.NDArray[Any]]] = {}

    def grid(self) -> Grid:
        while words := self._file.words():
            name = words[0]
            if not name.startswith("$") or name.startswith("$End"):
                message = f"a section must begin with $ and its name, got '{name[:40]}'"
                raise FormatError(message)
            read = self._section(name[1:])
            if read is None:
                self._skip_to_end(name[1:])
            else:
                read()
                if self._file.words()[:1] != [f"$End{name[1:]}"]:
                    message = f"section {name} must end with $End{name[1:]} after what it says to hold; it does not"
                    raise FormatError(message)
        return self._together()

    def _section(self, name: str) -> Any:
        """Return the function that reads a section; None for a section that is passed over."""
        known = {
            "MeshFormat": self._format,
            "PhysicalNames": self._physical_names,
            "Nodes": self._nodes_4 if self._version >= 4 else self._nodes_2,
            "Elements": self._elements_4 if self._version >= 4 else self._elements_2,
            "NodeData": self._node_data,
        }
        if name == "ParametricNodes":
            message = "nodes must have no parameters of curves and surfaces: save the file without them"
            raise FormatError(message)
        if self._version >= 4:
            known |= {"Entities": self._entities, "PartitionedEntities": self._partitioned}
        return known.get(name)

    def _skip_to_end(self, name: str) -> None:
        end = self._file.data.find(f"$End{name}".encode(), self._file.at)
        if end < 0:
            message = f"section ${name} must end with $End{name}; it does not"
            raise FormatError(message)
        if name == "Comments":
            self._notes.append(self._file.data[self._file.at : end].decode("utf-8", "replace"))
        self._file.at = end
        self._file.line()

    def _format(self) -> None:
        words = self._file.words()
        if len(words) != 3 or words[0] not in ("2", "2.0", "2.1", "2.2", "4.1") or words[2] not in ("4", "8"):
            message = (
                f"a .msh must be of version 2 to 2.2 or 4.1, got '{' '.join(words)[:40]}': save it as one of these"
            )
            raise FormatError(message)
        self._version, self._file.binary, self._size = float(words[0]), words[1] == "1", f"u{words[2]}"
        if self._file.binary:
            mark = self._file.data[self._file.at : self._file.at + 4]
            self._file.order = "<" if mark == b"\1\0\0\0" else ">"
            self._file.skip(4)

    def _physical_names(self) -> None:
        for _ in range(_count(self._file.words())):
            found = _NAME.fullmatch(self._file.line())
            if found is None or int(found[1]) >= len(_DIMENSIONS):
                message = "a physical name must be a dimension, a number and a name in quotes; one is not"
                raise FormatError(message)
            self._names[int(found[1]), int(found[2])] = found[3]

    def _sizes(self, n: int) -> list[int]:
        return [int(one) for one in self._file.numbers(self._size, n)]

    def _ints(self, n: int) -> list[int]:
        return [int(one) for one in self._file.numbers("i4", n)]

    def _partitioned(self) -> None:
        """Read the physical groups of the entities of a mesh that is cut into parts."""
        self._sizes(1)
        self._ints(2 * self._sizes(1)[0])  # ghosts: a number and a part each
        self._entities(partitioned=True)

    def _entities(self, partitioned: bool = False) -> None:
        """Read the physical groups of every entity; the rest is passed over."""
        for dimension, count in enumerate(self._sizes(4)):
            for _ in range(count):
                tag = self._ints(1)[0]
                if partitioned:  # the entity that it is a part of, and its parts
                    self._ints(2)
                    self._ints(self._sizes(1)[0])
                self._file.numbers("f8", 6 if dimension else 3)
                groups = self._ints(self._sizes(1)[0])
                self._groups[dimension, tag] = [abs(group) for group in groups]
                if dimension:
                    self._file.numbers("i4", self._sizes(1)[0])

    def _nodes_4(self) -> None:
        n_blocks, _, _, _ = self._sizes(4)
        for _ in range(n_blocks):
            dimension, _, parametric = self._ints(3)
            (count,) = self._sizes(1)
            self._tags.append(self._file.numbers(self._size, count).astype(np.int64))
            width = 3 + (dimension if parametric else 0)
            if not 3 <= width <= 6:
                message = f"nodes must lie on entities of dimension 0 to 3, got {dimension}"
                raise FormatError(message)
            self._points.append(self._file.numbers("f8", width * count).reshape(-1, width)[:, :3])

    def _nodes_2(self) -> None:
        count = _count(self._file.words())
        if self._file.binary:
            row = np.dtype([("tag", f"{self._file.order}i4"), ("place", f"{self._file.order}f8", 3)])
            rows = self._file.numbers("u1", count * row.itemsize).view(row)
            self._tags.append(rows["tag"].astype(np.int64))
            self._points.append(rows["place"].astype(np.float64))
            return
        rows = self._file.numbers("f8", 4 * count).reshape(-1, 4)
        self._tags.append(_as_tags(rows[:, 0]))
        self._points.append(rows[:, 1:])

    def _elements_4(self) -> None:
        n_blocks, _, _, _ = self._sizes(4)
        for _ in range(n_blocks):
            dimension, entity, number = self._ints(3)
            width = _type(number)[1] + 1
            (count,) = self._sizes(1)
            rows = self._file.numbers(self._size, width * count).reshape(-1, width)
            self._elements.append((self._groups.get((dimension, entity), []), number, rows[:, 1:].astype(np.int64)))

    def _elements_2(self) -> None:
        """Read elements, one after another in text and for the most part in binary files too: runs of them at a time.

        In text they begin with number, type and number of tags, in binary files with type, number of elements that
        follow, and number of tags; then come a number in binary files, the tags and the nodes.
        """
        left, file = _count(self._file.words()), self._file
        end = file.data.find(b"$EndElements", file.at)
        if file.binary:
            values = np.frombuffer(file.data, file.order + "i4", (len(file.data) - file.at) // 4, file.at)
        else:
            table = Cursor(file.data[file.at : max(end, file.at)])
            values = table.numbers("i8", len(table.data.split()))
        at, run, head = 0, 1, 4 if file.binary else 3
        while left > 0:
            if at + 3 > len(values):
                message = f"{left} more elements must follow; the section ends"
                raise FormatError(message)
            mark = values[at : at + 3].tolist()
            number, n_tags, following = mark[0] if file.binary else mark[1], mark[2], mark[1] if file.binary else 1
            width = head + n_tags + _type(number)[1]
            if following > 1:
                head, width, run, at = 1, width - 3, 1, at + 3
            run = following if following > 1 else min(run, left, (len(values) - at) // width if n_tags >= 0 else 0)
            if n_tags < 0 or not 0 < run <= left or at + run * width > len(values):
                message = (
                    f"{left} more elements must follow, each whole; one of type {number} with {n_tags} tags is not"
                )
                raise FormatError(message)
            rows = values[at : at + run * width].reshape(run, width)
            alike = (rows[:, 1:3] == mark[1:]).all(axis=1) & ((rows[:, 0] == number) | (head == 3))
            same = run if following > 1 or alike.all() else int(np.argmin(alike))
            self._rows(number, n_tags, rows[:same, head:])
            at, left = at + same * width, left - same
            run, head = 2 * run if same == run and following == 1 else 1, 4 if file.binary else 3
        file.at = file.at + 4 * at if file.binary else max(end, file.at)

    def _rows(self, number: int, n_tags: int, rows: IntArray) -> None:
        """Keep elements of version 2, rows of tags, the first being the physical group, and nodes."""
        groups = np.abs(rows[:, 0]) if n_tags else np.zeros(len(rows), np.int64)
        for group in np.unique(groups).tolist():
            chosen = rows[groups == group, n_tags:].astype(np.int64)
            self._elements.append(([group] if group != _EMPTY_GROUP else [], number, chosen))

    def _node_data(self) -> None:
        """Read values at nodes: texts (a name), real numbers (a time), whole ones (step, width, number of rows)."""
        n_texts = _count(self._file.words())
        texts = [self._file.line() for _ in range(min(n_texts, _MOST_TEXTS))]
        self._file.binary, binary = False, self._file.binary
        self._file.numbers("f8", _count(self._file.words()))
        whole = self._file.numbers("i8", _count(self._file.words())).tolist()
        self._file.binary = binary
        if len(whole) < 3 or not 0 < n_texts <= _MOST_TEXTS or not 0 < whole[1] <= 9:
            message = "node data must have a name, and a number of components up to 9 and of nodes; they have not"
            raise FormatError(message)
        if binary:
            self._file.line()
        width, count = whole[1], whole[2]
        order = self._file.order
        if binary:
            row = np.dtype([("tag", f"{order}i4"), ("value", f"{order}f8", width)])
            rows = self._file.numbers("u1", count * row.itemsize).view(row)
            tags, values = rows["tag"].astype(np.int64), rows["value"].astype(np.float64).reshape(-1, width)
        else:
            table = self._file.numbers("f8", (1 + width) * count).reshape(-1, 1 + width)
            tags, values = _as_tags(table[:, 0]), table[:, 1:]
        self._data[texts[0].strip('"')] = tags, values

    def _together(self) -> Grid:
        points = np.concatenate([np.empty((0, 3)), *self._points])
        numbers = _Numbers(np.concatenate([np.empty(0, np.int64), *self._tags]))
        blocks: list[Block] = []
        sets: dict[str, list[IntArray]] = {}
        for groups, number, tags in self._elements:
            kind, n_nodes = _type(number)
            block = checked_corners(kind, numbers.of(tags.reshape(-1, n_nodes)), len(points))
            dimension = CELLS.get(kind, (0, 3))[1]
            names = [self._names.get((dimension, group)) or f"{_DIMENSIONS[dimension]}_{group}" for group in groups]
            blocks.append(replace(block, groups=tuple(names)))
            for name in names:
                sets.setdefault(name, []).append(block.corners.ravel())
        node_sets = {name: np.unique(np.concatenate(parts)) for name, parts in sets.items()}
        data = {}
        for name, (tags, values) in self._data.items():
            column = np.full((len(points), values.shape[1]), np.nan)
            column[numbers.of(tags)] = values
            data[name] = column if values.shape[1] > 1 else column[:, 0]
        return Grid(points, blocks, data, node_sets, self._notes)


class _Numbers:
    """Indices of nodes by their tags in the file, which may be any numbers in any order."""

    def __init__(self, tags: IntArray) -> None:
        self._order = np.argsort(tags, kind="stable")
        self._sorted = tags[self._order]
        n = len(tags)
        self._first = int(self._sorted[0]) if n and self._sorted[-1] - self._sorted[0] == n - 1 else None

    def of(self, tags: IntArray) -> IntArray:
        """Return the indices of nodes; raise `FormatError` if one is not in the file."""
        if not len(self._sorted) or not tags.size:
            place = np.zeros(tags.shape, np.int64)
        elif self._first is not None:  # as in most files
            place = np.clip(tags - self._first, 0, len(self._sorted) - 1)
        else:
            place = np.minimum(np.searchsorted(self._sorted, tags), len(self._sorted) - 1)
        if tags.size and (not len(self._sorted) or (self._sorted[place] != tags).any()):
            message = f"elements must join nodes of the file; one names a node that is not among its {len(self._order)}"
            raise FormatError(message)
        return np.asarray(self._order[place], np.int64) if tags.size else place


def _type(number: int) -> tuple[str, int]:
    if number not in _TYPES:
        message = f"elements must be of a type that is read ({', '.join(map(str, _TYPES))}), got type {number}"
        raise FormatError(message)
    return _TYPES[number]


def _as_tags(numbers: npt.NDArray[Any]) -> IntArray:
    """Return tags of nodes that were read among real numbers; raise `FormatError` if one is not whole."""
    if not (np.abs(numbers) < 2**53).all() or (numbers != np.floor(numbers)).any():
        message = "tags of nodes must be whole numbers; one is not"
        raise FormatError(message)
    return numbers.astype(np.int64)


def _count(words: list[str]) -> int:
    if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 18:
        message = f"a line must hold one count, got '{' '.join(words)[:40]}'"
        raise FormatError(message)
    return int(words[0])
