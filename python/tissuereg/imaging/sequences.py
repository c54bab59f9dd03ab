"""Fields at many moments as one grid transform, 3D and time, as 3D Slicer reads it: NRRD with a list of grids."""

import gzip
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import place
from tissuereg.body.surroundings import SpaceMap
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.imaging.images import Grid
from tissuereg.imaging.sampled import SLABS, Sampled, Tally
from tissuereg.imaging.transforms import Written, grid_of
from tissuereg.io.atomic import atomic_file

#: Ending of the name of such a file.
ENDING = ".seq.nrrd"


def write_sequence(
    path: str | os.PathLike[str],
    times: Sequence[float],
    spaces: Iterable[SpaceMap],
    *,
    like: Any = None,
    spacing: Any = None,
    threads: int = 0,
) -> Written:
    """Write fields as grids of displacements from places before the deformation to those after it (``modeling``).

    `times`: of the fields, s; `spaces`: the field at each time, made one after the other. Else as
    `Registration.transform`; the number of voxels of all moments together is bounded.
    """
    target = place("path", path, error=ArgumentError)
    if not target.name.lower().endswith(ENDING):
        message = f"`path` of a transform with time must end in {ENDING}, got '{target}'"
        raise FormatError(message, where=str(target))
    if not len(times):
        message = "`times` must hold at least one moment, got none"
        raise ArgumentError(message, where="times")
    grid, tally = None, Tally()
    with atomic_file(target) as draft, draft.open("wb") as file:
        for space in spaces:
            if grid is None:
                grid = grid_of(space, like, spacing, back=False)
                _check_size(grid, len(times))
                file.write(_header(grid, times))
                packed = gzip.GzipFile(filename="", fileobj=file, mode="wb", compresslevel=1, mtime=0)
            sampled = Sampled(space, grid, back=False, threads=threads)
            for _, moved in sampled.slabs(tally):
                packed.write(np.ascontiguousarray(moved, "<f4").tobytes())
        packed.close()
        if not tally.inside:
            message = "the grid must reach into the body; none of its voxels lies there: check the frames"
            raise ArgumentError(message, where="like" if spacing is None else "spacing")
    return Written(Path(target), tally.moved_mm, tally.outside, None)


def _check_size(grid: Grid, count: int) -> None:
    voxels = count * int(np.prod(grid.size))
    if voxels > SLABS.most:
        message = (
            f"a transform with time may have {SLABS.most} voxels, got {count} moments of "
            f"{' x '.join(map(str, grid.size))}; take a coarser grid"
        )
        raise ArgumentError(message, where="spacing")


def _header(grid: Grid, times: Sequence[float]) -> bytes:
    """Return the header, as 3D Slicer's documentation of transforms has it for three dimensions and time."""

    def vector(values: Any) -> str:
        return "(" + ",".join(repr(float(x)) for x in values) + ")"

    columns, rows, slices = grid.size
    lines = [
        "NRRD0005",
        "type: float",
        "dimension: 5",
        "space: left-posterior-superior",
        f"sizes: 3 {columns} {rows} {slices} {len(times)}",
        f"space directions: none {' '.join(vector(step) for step in grid.steps.T)} none",
        "kinds: vector domain domain domain list",
        'labels: "" "" "" "" "time"',
        'units: "" "" "" "" "s"',
        "endian: little",
        "encoding: gzip",
        f"space origin: {vector(grid.origin)}",
        "measurement frame: (1,0,0) (0,1,0) (0,0,1)",
        "axis 3 index type:=numeric",
        f"axis 3 index values:={' '.join(repr(float(t)) for t in times)}",
        "displacement field type:=modeling",
        "intent_code:=1006",
    ]
    return ("\n".join(lines) + "\n\n").encode("ascii")


__all__ = ["ENDING", "write_sequence"]
