"""What a mesh file of another program holds, before it becomes a body or a surface.

Cells of higher order are kept as their corners: every format lists those first.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError

#: Number of corners and dimension of every kind of cell that is read; other kinds are known by name only.
CELLS = {"vertex": (1, 0), "line": (2, 1), "triangle": (3, 2), "quad": (4, 2), "tetra": (4, 3)}

#: Kinds of cells of a surface, and of its edges and points.
FLAT_KINDS = ("vertex", "vertices", "line", "polyline", "triangle", "quad", "polygon", "curved polygon")

_FRAME_NOTE = re.compile(r"\bSPACE\s*[=:]\s*\W?\s*([A-Za-z-]+)", re.IGNORECASE)
_FRAMES = {"RAS": "RAS", "LPS": "LPS", "RIGHT-ANTERIOR-SUPERIOR": "RAS", "LEFT-POSTERIOR-SUPERIOR": "LPS"}
_UNIT_NOTE = re.compile(r"\bunits?\b\s*[:= ]\s*\W?\s*(milli|centi)?(mm|cm|m|met(?:er|re)s?)\b", re.IGNORECASE)


@dataclass(frozen=True)
class Block:
    """Cells of one kind.

    `kind`: its name, such as ``tetra``; `corners` (n_cells, n_corners): indices of points; `curved`: whether the file
    has further points on the edges of these cells; `groups`: names of the groups of which all of them are.
    """

    kind: str
    corners: IntArray
    curved: bool = False
    groups: tuple[str, ...] = ()


@dataclass
class Grid:
    """Content of a mesh file, in the file's own unit.

    `points` (n, 3) float64; `blocks`: cells; `point_data`: arrays with one row a point, by name; `node_sets`: indices
    of points, sorted, by name; `notes`: texts in which the file may state its frame and its unit; `pieces` (n,): the
    piece of the file that each point is from, None where there is one.
    """

    points: FloatArray
    blocks: list[Block]
    point_data: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    node_sets: dict[str, IntArray] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    pieces: IntArray | None = None

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds of cells, sorted."""
        return sorted({block.kind for block in self.blocks if len(block.corners)})

    def of_kind(self, kind: str) -> IntArray:
        """Return the corners (n, k) of all cells of a kind of `CELLS`, in the order of the file, each once."""
        found = [block.corners for block in self.blocks if block.kind == kind]
        return _once(found) if found else np.empty((0, CELLS[kind][0]), np.int64)

    def triangles(self) -> IntArray:
        """Return all faces as triangles (n, 3); quads and polygons are cut."""
        flat = [b.corners for b in self.blocks if b.kind in ("triangle", "quad", "polygon") and len(b.corners)]
        sizes = sorted({faces.shape[1] for faces in flat})
        faces = [_once([one for one in flat if one.shape[1] == size]) for size in sizes]
        return np.concatenate([np.empty((0, 3), np.int64), *(_fans(self.points, each) for each in faces)])


def checked_corners(kind: str, rows: npt.NDArray[Any], n_points: int) -> Block:
    """Return cells, rows of point indices (n, k), as a block of corners; raise `FormatError` if one is no point."""
    corners = rows[:, : CELLS[kind][0]] if kind in CELLS else rows
    if rows.size and (rows.min() < 0 or rows.max() >= n_points):
        message = f"cells must join points 0 to {n_points - 1}; a {kind} names {rows.min()} to {rows.max()}"
        raise FormatError(message)
    return Block(kind, np.ascontiguousarray(corners, np.int64), rows.shape[1] > corners.shape[1])


def _once(parts: list[IntArray]) -> IntArray:
    """Return cells (n, k) of several blocks, each once: some formats repeat a cell for each of its groups."""
    rows = np.concatenate(parts)
    if len(parts) < 2:
        return rows
    ascending = np.sort(rows, axis=1)
    order = np.lexsort(ascending.T)
    repeats = np.zeros(len(rows), bool)
    repeats[order[1:]] = (ascending[order[1:]] == ascending[order[:-1]]).all(axis=1)
    return rows[~repeats]


def _fans(points: FloatArray, faces: IntArray) -> IntArray:
    """Cut faces of k corners into k - 2 triangles, round the first corner from which none of them is turned over."""
    k = faces.shape[1]
    if k == 3:
        return faces
    turned = np.array([np.roll(np.arange(k), -shift) for shift in range(min(k, _MOST_TURNS))])
    best, chosen = np.full(len(faces), -np.inf), np.zeros(len(faces), np.int64)
    for number, order in enumerate(turned):
        at = points[faces[:, order]]
        arms = at[:, 1:] - at[:, :1]
        normals = np.cross(arms[:, :-1], arms[:, 1:])
        # The sum of a fan's normals is that of the face, whatever the corner.
        worst = np.einsum("ijk,ik->ij", normals, normals.sum(axis=1)).min(axis=1)
        better = (best <= 0) & (worst > best)
        best, chosen = np.where(better, worst, best), np.where(better, number, chosen)
    rows = np.take_along_axis(faces, turned[chosen], axis=1)
    return np.concatenate([np.stack([rows[:, 0], rows[:, i], rows[:, i + 1]], axis=1) for i in range(1, k - 1)])


#: Corners from which a polygon is tried to be cut.
_MOST_TURNS = 12


def frame_in(notes: Iterable[str]) -> str | None:
    """Return the frame, ``LPS`` or ``RAS``, that texts state as 3D Slicer does (``SPACE=RAS``); None if none does.

    Raises `FormatError` if they state another one, or both.
    """
    stated = {found[1].upper() for note in notes for found in _FRAME_NOTE.finditer(note)}
    frames = {_FRAMES.get(word) for word in stated}
    if len(frames) > 1 or None in frames:
        message = f"a file may state one frame, LPS or RAS; it states {' and '.join(sorted(stated))}"
        raise FormatError(message)
    return frames.pop() if frames else None


def unit_in(notes: Iterable[str]) -> str | None:
    """Return the unit that the first text with one states, ``mm``, ``cm`` or ``m``; None if none does."""
    for note in notes:
        found = _UNIT_NOTE.search(note)
        if found is None:
            continue
        prefix, word = (found[1] or "").lower(), found[2].lower()
        if word in ("mm", "cm"):
            return None if prefix else word
        return {"": "m", "milli": "mm", "centi": "cm"}[prefix]
    return None
