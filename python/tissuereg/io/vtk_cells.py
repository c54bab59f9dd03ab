"""Cells by VTK's numbers, for its XML and its legacy files."""

from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import IntArray
from tissuereg.errors import FormatError
from tissuereg.io.grid import CELLS, Block, checked_corners

#: VTK's number of four-node tetrahedra.
TETRA = 10

#: Kind of each VTK cell type, of first and higher order; the corners come first in all that `CELLS` lists.
_KINDS = {
    1: "vertex", 2: "vertices", 3: "line", 4: "polyline", 5: "triangle", 6: "strip", 7: "polygon", 8: "pixel",
    9: "quad", 10: "tetra", 11: "voxel", 12: "hexahedron", 13: "wedge", 14: "pyramid", 15: "pentagonal prism",
    16: "hexagonal prism", 21: "line", 22: "triangle", 23: "quad", 24: "tetra", 25: "hexahedron", 26: "wedge",
    27: "pyramid", 28: "quad", 29: "hexahedron", 30: "quad", 31: "wedge", 32: "wedge", 33: "hexahedron", 34: "triangle",
    35: "line", 36: "curved polygon", 37: "pyramid", 41: "convex point set", 42: "polyhedron",
    68: "line", 69: "triangle", 70: "quad", 71: "tetra", 72: "hexahedron", 73: "wedge", 74: "pyramid",
    75: "line", 76: "triangle", 77: "quad", 78: "tetra", 79: "hexahedron", 80: "wedge", 81: "pyramid",
}  # fmt: skip


def vtk_blocks(types: Any, ends: Any, joined: Any, n_points: int) -> list[Block]:
    """Return cells as blocks, one for each type and number of points.

    `types` (n,): VTK's cell types; `ends` (n,): where each cell's points end in `joined`; `joined`: the cells' points
    one after another; `n_points`: number of points of the file. Raises `FormatError` if they do not fit together.
    """
    types, ends = np.asarray(types, np.int64), np.asarray(ends, np.int64)
    begins = np.concatenate([[0], ends])[:-1]
    if len(types) != len(ends) or (begins > ends).any() or (len(ends) and not 0 <= ends[-1] <= len(joined)):
        message = f"{len(types)} cells must have ascending ends within {len(joined)} points of cells; they have not"
        raise FormatError(message)
    sizes, blocks = ends - begins, []
    for number, size in np.unique(np.stack([types, sizes], axis=1), axis=0).tolist():
        if number == 0 or size == 0:  # VTK's empty cell
            continue
        kind = _KINDS.get(number, f"VTK type {number}")
        if size < CELLS.get(kind, (1,))[0]:
            message = f"a {kind} must have {CELLS[kind][0]} points or more, got {size}"
            raise FormatError(message)
        chosen = begins[(types == number) & (sizes == size)]
        rows = np.asarray(joined, np.int64)[chosen[:, np.newaxis] + np.arange(size)]
        blocks.extend(_plain(checked_corners(kind, rows, n_points)))
    return blocks


def flat_blocks(kind: int, ends: IntArray, joined: npt.NDArray[Any], n_points: int) -> list[Block]:
    """Return cells of polygonal data as blocks; `kind`: VTK's type for any size; the rest as in `vtk_blocks`."""
    return vtk_blocks(np.full(len(ends), kind), ends, joined, n_points)


def _plain(block: Block) -> list[Block]:
    """Return a block with strips as triangles, pixels as quads, and polygons of three or four corners as such."""
    corners, size = block.corners, block.corners.shape[1]
    if block.kind == "strip":
        # Every second triangle of a strip is turned over.
        steps = [(i, i + 1, i + 2) if i % 2 == 0 else (i + 1, i, i + 2) for i in range(size - 2)]
        return [Block("triangle", corners[:, list(step)]) for step in steps]
    if block.kind == "pixel" and size == 4:
        return [Block("quad", corners[:, [0, 1, 3, 2]])]
    if block.kind == "polygon":
        return [Block({3: "triangle", 4: "quad"}.get(size, "polygon"), corners)] if size > 2 else []
    return [block]
