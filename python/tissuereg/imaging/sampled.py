"""A registered field at the voxels of an image, from places before the deformation to those after it or back.

The field is linear in tetrahedra, of the body and around it, so that its inverse is exact: it is linear in the same
tetrahedra, deformed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.surroundings import SpaceMap
from tissuereg.imaging.images import Grid
from tissuereg.io.points import turned

Singles = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]


class Mark(IntEnum):
    """What a voxel lies in: beyond the field, around the body, inside it."""

    BEYOND = 0
    AROUND = 1
    INSIDE = 2


@dataclass(frozen=True)
class Slabs:
    """How much of a grid is made at a time, and at all: `at_once` slices; `most` voxels of a transform, 3.2 GB."""

    at_once: int = 16
    most: int = 270_000_000


SLABS = Slabs()


@dataclass
class Tally:
    """How far voxels move, mm: `total` and `most` of `inside` voxels in the body; `outside`: number around it."""

    total: float = 0.0
    most: float = 0.0
    inside: int = 0
    outside: int = 0

    def add(self, moved: Singles, by: Bytes) -> None:
        """Count some slices."""
        lengths = np.linalg.norm(moved[by == Mark.INSIDE], axis=1)
        self.total += float(lengths.sum(dtype=np.float64))
        self.most = max(self.most, float(lengths.max(initial=0.0)))
        self.inside += len(lengths)
        self.outside += int(np.count_nonzero(by == Mark.AROUND))

    @property
    def moved_mm(self) -> tuple[float, float]:
        """Mean and largest displacement of the voxels in the body, mm."""
        return self.total / self.inside, self.most


@dataclass(frozen=True, eq=False)
class Sampled:
    """The displacement at the voxels of a grid, mm, LPS.

    `space`: the field in and around the body; `grid`: of the image; `back`: whether voxels are places after the
    deformation, and the displacement leads back; `threads`: threads to use, 0 takes all cores.
    """

    space: SpaceMap
    grid: Grid
    back: bool
    threads: int = 0

    @cached_property
    def _cells(self) -> tuple[FloatArray, FloatArray, IntArray, int]:
        nodes, moved, tets, inner = self.space.cells()
        frame = self.space.mesh.frame
        nodes, moved = (turned(one, frame, "LPS") for one in (nodes, moved))
        if self.back:
            nodes, moved = nodes + moved, -moved
        return self.grid.indices(nodes), np.ascontiguousarray(moved), np.ascontiguousarray(tets), inner

    def slices(self, first: int, count: int) -> tuple[Singles, Bytes]:
        """Return the displacement at some slices, (count, rows, columns, 3), mm, and what each voxel lies in."""
        columns, rows, _ = self.grid.size
        at, moved, tets, inner = self._cells
        return _core.rasterise(at, tets, moved, inner, (first, count, rows, columns), self.threads)

    def slabs(self, tally: Tally) -> Iterator[tuple[slice, Singles]]:
        """Yield the displacement at all slices, some at a time, with their numbers; count it in `tally`."""
        for first in range(0, self.grid.size[2], SLABS.at_once):
            some = slice(first, min(first + SLABS.at_once, self.grid.size[2]))
            moved, by = self.slices(first, some.stop - first)
            tally.add(moved, by)
            yield some, moved

    def inside(self, of_nodes: FloatArray, first: int, count: int) -> Singles:
        """Return numbers of the nodes, (n_nodes,), interpolated at some slices, NaN outside the body."""
        columns, rows, _ = self.grid.size
        at, _, tets, inner = self._cells
        spread = np.zeros((len(at), 3))
        spread[: self.space.mesh.n_nodes, 0] = of_nodes
        found, by = _core.rasterise(at, tets[inner:].copy(), spread, 0, (first, count, rows, columns), self.threads)
        return np.where(by == Mark.INSIDE, found[..., 0], np.float32(np.nan))

    def residual_mm(self, most: int = 2000) -> float:
        """Return by how much forward and back differ at 999 of 1,000 of some voxels inside the body, mm."""
        slices = self.grid.size[2]
        reach = self._cells[0][: self.space.mesh.n_nodes, 2]
        low, high = np.clip((np.ceil(reach.min()), np.floor(reach.max())), 0, slices - 1)
        chosen = np.linspace(low, high, min(slices, 8)).astype(int)
        places, moved = [], []
        for slice_ in np.unique(chosen):
            field, by = self.slices(int(slice_), 1)
            inside = np.argwhere(by[0] == Mark.INSIDE)
            places.append(np.column_stack([inside[:, ::-1], np.full(len(inside), slice_)]).astype(np.float64))
            moved.append(field[0][by[0] == Mark.INSIDE].astype(np.float64))
        at, by_grid = self.grid.places(np.concatenate(places)), np.concatenate(moved)
        if not len(at):
            return 0.0
        some = np.random.default_rng(0).permutation(len(at))[:most]
        frame = self.space.mesh.frame
        ends = turned(at[some] + by_grid[some], "LPS", frame)
        forward = turned(self.space.at(ends)[0], frame, "LPS")
        off = np.linalg.norm(forward + by_grid[some], axis=1)
        # A place at the skin may be on either side of it.
        return float(np.quantile(off, 0.999))


__all__ = ["SLABS", "Mark", "Sampled", "Tally"]
