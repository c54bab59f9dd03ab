"""From the content of a mesh file to a body: its tetrahedra, node sets, unit, frame and topology."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Coincident, Frame
from tissuereg._base.provenance import warn
from tissuereg.body.mesh import Mesh
from tissuereg.body.topology import sound_mesh
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.extents import UNITS_MM, check_extent
from tissuereg.io.foreign import reading
from tissuereg.io.grid import FLAT_KINDS, Grid
from tissuereg.io.notes import frame_in, unit_in


def mesh_of_grid(file: Path, grid: Grid, coincident: Coincident = "certain") -> tuple[Mesh, IntArray]:
    """Return the mesh, in mm, that the content of a file makes, and for each node the index (n_nodes,) of its point.

    `file`: its name, for messages; `grid`: its content; `coincident`: as in `read_mesh`. Raises the errors of that.
    """
    with reading(file, "a mesh"):
        frame, unit = frame_in(grid.notes), unit_in(grid.notes) or "mm"
    _refuse_other_cells(file, grid)
    tets = grid.of_kind("tetra")
    used = np.flatnonzero(np.bincount(tets.ravel(), minlength=len(grid.points)))
    sets = _node_sets(file, grid)
    if len(used) < len(grid.points):
        curved = any(block.kind == "tetra" and block.curved for block in grid.blocks)
        _warn_of_dropped(file, len(grid.points) - len(used), curved)
    new_from_old = np.full(len(grid.points), -1, dtype=np.int64)
    new_from_old[used] = np.arange(len(used))
    kept = {name: (new := new_from_old[old])[new >= 0] for name, old in sets.items()}
    for name in (name for name, old in sets.items() if len(old) and not len(kept[name])):
        warn(f"{file}: node set '{name}' is empty: none of its {len(sets[name])} points is the corner of a tetrahedron")
    nodes = grid.points[used] * UNITS_MM[unit]
    pieces = None if grid.pieces is None else grid.pieces[used]
    mesh, rows = placed_mesh(file, nodes, new_from_old[tets], kept, coincident, frame, pieces)
    return mesh, used[rows]


def _refuse_other_cells(file: Path, grid: Grid) -> None:
    others = [kind for kind in grid.kinds if kind not in (*FLAT_KINDS, "tetra")]
    if others:
        message = f"{file} must be made of tetrahedra; it also holds cells of kind {', '.join(others)}"
        raise FormatError(message, where=str(file))
    if "tetra" not in grid.kinds:
        found = ", ".join(grid.kinds) or "no cells"
        flat = len(grid.points) == 0 or np.ptp(grid.points, axis=0).min() == 0
        advice = "It is flat: a mesh of a body is needed" if flat else how_to_fill(file)
        message = f"{file} must hold tetrahedra; it holds {found} only. {advice}"
        raise FormatError(message, where=str(file))


def _node_sets(file: Path, grid: Grid) -> dict[str, IntArray]:
    sets = dict(grid.node_sets)
    for name, values in grid.point_data.items():
        if values.ndim == 1 and np.isin(values, (0, 1)).all():
            sets[name] = np.flatnonzero(values).astype(np.int64)
        elif name == "fixed":
            message = f"point data 'fixed' in {file} must be one 0 or 1 per node, got other values"
            raise FormatError(message, where=f"{file}:fixed")
    return sets


def _warn_of_dropped(file: Path, n_dropped: int, curved: bool) -> None:
    what = "mid-edge nodes of the ten-node tetrahedra" if curved else "nodes that belong to no tetrahedron"
    warn(f"{file}: {n_dropped} {what} were dropped; the corner nodes keep their order")


def placed_mesh(
    file: Path | str,
    nodes: FloatArray,
    tets: IntArray,
    sets: Mapping[str, Any],
    coincident: Coincident,
    frame: Frame | None = None,
    pieces: IntArray | None = None,
) -> tuple[Mesh, IntArray]:
    """Return the sound mesh of nodes (n, 3) in mm, tets (m, 4) and node sets by name, and the rows of its nodes.

    `file`: its name, for messages; `coincident`, `frame`: as in `read_mesh`; `pieces` (n,): the piece of the file of
    each node. Raises `MeshError`, `ShapeError` or `UnitError` if it is no body; they name the file.
    """
    if len(nodes) and np.isfinite(nodes).all():
        extent = float(np.ptp(nodes, axis=0).max())
        check_extent(extent, "mm", str(file), "multiply its lengths by {factor:g}")
    with named_errors(file):
        return sound_mesh(nodes, tets, sets, frame, coincident=coincident, pieces=pieces, place=str(file))


@contextlib.contextmanager
def named_errors(file: Path | str) -> Iterator[None]:
    """Put the name of a file before the message of an error of a mesh that is made in the block."""
    try:
        yield
    except (MeshError, ShapeError) as error:
        error.args = (f"{file}: {error}",)
        raise


def how_to_fill(file: Path) -> str:
    """Return advice for a file that holds a surface only."""
    return (
        f"Fill the surface with tetrahedra first: tissuereg mesh {file} --size MM --out BODY.vtu "
        "(by pytetwild: pip install 'tissuereg[mesh]')"
    )
