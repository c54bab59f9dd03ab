"""What a mesh file of another program holds, before it becomes a body or a surface.

Cells of higher order are kept as their corners: every format lists those first.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.polygons import cut

#: Number of corners and dimension of every kind of cell that is read; other kinds are known by name only.
CELLS = {"vertex": (1, 0), "line": (2, 1), "triangle": (3, 2), "quad": (4, 2), "tetra": (4, 3)}

#: Kinds of cells of a surface, and of its edges and points.
FLAT_KINDS = ("vertex", "vertices", "line", "polyline", "triangle", "quad", "polygon", "curved polygon")


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
        return np.concatenate([np.empty((0, 3), np.int64), *(cut(self.points, each) for each in faces)])


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
