"""A registered field as a grid transform: NRRD as 3D Slicer reads it, and ITK's transform files.

The displacements are in mm and LPS. ``modeling`` leads from places before the deformation to those after it,
``resampling`` back, as images are warped and as ITK's files mean it.
"""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, found, place, real
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import DIRECTIONS, Direction
from tissuereg.body.surroundings import SpaceMap
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.imaging.images import Grid, itk, read_image, write_image
from tissuereg.imaging.sampled import SLABS, Sampled, Tally
from tissuereg.io.atomic import atomic_file
from tissuereg.io.points import turned

#: Endings of ITK's transform files.
OF_ITK = (".h5", ".tfm")


@dataclass(frozen=True)
class Written:
    """A grid transform that was written.

    `path`: its file; `moved_mm`: mean and largest displacement of voxels inside the body, mm; `outside`: number of
    voxels around the body to which the field was extended; `residual_mm`: by how much forward and back differ at 999 of
    1,000 voxels inside the body, mm; None for ``modeling``.
    """

    path: Path
    moved_mm: tuple[float, float]
    outside: int
    residual_mm: float | None


def grid_of(space: SpaceMap, like: Any, spacing: Any, *, back: bool) -> Grid:
    """Return the grid of an image `like`, or one of a `spacing` in mm over the body and its surroundings."""
    if (like is None) == (spacing is None):
        message = f"one of `like` and `spacing` must be given, got {found(like)} and {found(spacing)}"
        raise ArgumentError(message, where="like")
    if like is not None:
        return Grid.of(read_image(like))
    step = real("spacing", spacing, unit="mm")
    if not step > 0.0:
        message = f"`spacing` must be above 0 mm, got {step:g}"
        raise ArgumentError(message, where="spacing")
    nodes, moved, _, _ = space.cells()
    # On the way back, voxels are places after the deformation.
    nodes = turned(nodes + moved if back else nodes, space.mesh.frame, "LPS")
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    sides = (high - low).tolist()
    if math.prod(side / step + 1.0 for side in sides) > SLABS.most:
        over = " x ".join(f"{side:.0f}" for side in sides)
        message = f"`spacing` must leave at most {SLABS.most} voxels over {over} mm, got {step:g} mm"
        raise ArgumentError(message, where="spacing")
    return Grid.over(low, high, step)


def write_transform(
    space: SpaceMap,
    path: str | os.PathLike[str],
    *,
    like: Any = None,
    spacing: Any = None,
    direction: Direction | None = None,
    std: tuple[str | os.PathLike[str], FloatArray] | None = None,
    threads: int = 0,
) -> Written:
    """Write a field as a grid transform; see `Registration.transform`.

    `std`: file for the standard deviation of every voxel, and that of the nodes, (n_nodes,), mm.
    """
    target = place("path", path, error=ArgumentError)
    ending = target.suffix.lower()
    if ending not in (*OF_ITK, ".nrrd"):
        message = f"`path` must end in .nrrd, .h5 or .tfm, got '{target}'"
        raise FormatError(message, where=str(target))
    if direction is not None:
        check_choice("direction", direction, DIRECTIONS, ArgumentError)
    way = direction or ("resampling" if ending in OF_ITK else "modeling")
    if ending in OF_ITK and way != "resampling":
        message = f"`direction` must be 'resampling' in a {ending} file: ITK's transforms lead back; got '{way}'"
        raise ArgumentError(message, where="direction")
    if std is not None and place("std", std[0]).suffix.lower() != ".nrrd":
        message = f"`std` must end in .nrrd, got {found(str(std[0]))}"
        raise FormatError(message, where=str(std[0]))
    for name, other in (("std", None if std is None else std[0]), ("like", like)):
        if other is not None and place(name, other).resolve() == target.resolve():
            message = f"`{name}` must be another file than `path`, got '{target}' for both"
            raise ArgumentError(message, where=name)
    itk()
    grid = grid_of(space, like, spacing, back=way == "resampling")
    columns, rows, slices = grid.size
    if columns * rows * slices > SLABS.most:
        message = f"a grid transform may have {SLABS.most} voxels, got {columns} x {rows} x {slices}"
        raise ArgumentError(message, where="like" if spacing is None else "spacing")
    sampled = Sampled(space, grid, way == "resampling", threads)
    values = np.empty((slices, rows, columns, 3), np.float32)
    tally = Tally()
    for some, moved in sampled.slabs(tally):
        values[some] = moved
    if not tally.inside:
        message = "the grid must reach into the body; none of its voxels lies there: check the frames"
        raise ArgumentError(message, where="like" if spacing is None else "spacing")
    residual = sampled.residual_mm() if way == "resampling" else None
    if std is not None:  # before the transform, so that a full disk leaves none without it
        file, of_nodes = std
        firsts = range(0, slices, SLABS.at_once)
        parts = [sampled.inside(of_nodes, first, min(SLABS.at_once, slices - first)) for first in firsts]
        image = grid.image(np.concatenate(parts))
        image.SetMetaData("content", "standard deviation of the place, mm; NaN outside the body")
        write_image(file, image)
    _write(target, grid, values, way)
    return Written(target, tally.moved_mm, tally.outside, residual)


def _write(target: Path, grid: Grid, values: Any, way: str) -> None:
    sitk, ending = itk(), target.suffix.lower()
    if ending == ".nrrd":
        image = grid.image(values)
        image.SetMetaData("displacement field type", way)
        image.SetMetaData("intent_code", "1006")
        write_image(target, image)
        return
    transform = sitk.CompositeTransform([sitk.DisplacementFieldTransform(grid.image(values.astype(np.float64)))])
    with atomic_file(target) as draft:
        sitk.WriteTransform(transform, str(draft))


__all__ = ["DIRECTIONS", "Written", "grid_of", "write_transform"]
