"""What a registered body moves: points, surfaces, label maps and volumes, each as its kind does."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import flag, place
from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg._base.choices import Unit
from tissuereg.body.surroundings import SpaceMap
from tissuereg.body.triangles import Triangles
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.imaging.images import Grid, ending, itk, labels_of, read_image, threaded, write_image
from tissuereg.imaging.sampled import Mark, Sampled, Tally
from tissuereg.io.csv import write_table
from tissuereg.io.mrk_json import write_mrk_json
from tissuereg.io.surfaces import read_triangles
from tissuereg.io.triangles_out import check_surface_target, write_triangles

if TYPE_CHECKING:
    from tissuereg.registration.field import PointAnswer, RegisteredField


@dataclass(frozen=True)
class Warped:
    """What was moved and written.

    `moved_mm`: mean and largest displacement of points, or of voxels inside the body, mm; `outside`: number of points
    outside the body, or of voxels to which the field was extended; `residual_mm`: of images, by how much forward and
    back differ at 999 of 1,000 voxels inside the body, mm; None for points and surfaces.
    """

    moved_mm: tuple[float, float]
    outside: int
    residual_mm: float | None = None


def warp_points(field: "RegisteredField", points: dict[str, FloatArray], out: Path) -> Warped:
    """Write where named points (3,), mm, in the frame of the body, are now: a table, or .mrk.json for 3D Slicer."""
    if not points:
        message = "there must be at least one point, got none"
        raise ArgumentError(message, where="points")
    answer = field.at(np.array(list(points.values())))
    if out.name.lower().endswith(".mrk.json"):
        told = [
            f"standard deviation {std:.2f} mm" + ("" if flag is None else f"; {flag}")
            for std, flag in zip(answer.std, answer.flag, strict=True)
        ]
        places = zip(points, zip(answer.mean.tolist(), told, strict=True), strict=True)
        write_mrk_json(out, dict(places), field.mesh.frame)
    else:
        header = ["point", "x_mm", "y_mm", "z_mm", "moved_x_mm", "moved_y_mm", "moved_z_mm", "std_mm", "flag"]
        rows = [
            [name, *answer.reference[i].tolist(), *answer.mean[i].tolist(), float(answer.std[i]), answer.flag[i]]
            for i, name in enumerate(points)
        ]
        write_table(out, header, rows)
    return _of(answer)


def warp_surface(
    field: "RegisteredField", surface: Any, path: str | os.PathLike[str], *, unit: Unit | None = None
) -> Warped:
    """Write a surface with its vertices moved; `surface`: a file, `Triangles` or arrays, in the frame of the body."""
    out = place("path", path)
    check_surface_target(out)
    given = read_triangles(surface, unit, frame=field.mesh.frame)
    answer = field.at(given.vertices, covariance=False)
    write_triangles(out, Triangles(answer.mean, given.triangles, given.frame or field.mesh.frame))
    return _of(answer)


def _of(answer: "PointAnswer") -> Warped:
    moved = np.linalg.norm(answer.mean - answer.reference, axis=1)
    return Warped((float(moved.mean()), float(moved.max())), int((~answer.inside).sum()))


def warp_image(
    field: "RegisteredField",
    image: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    labels: bool,
    like: str | os.PathLike[str] | None = None,
    threads: int = 0,
) -> Warped:
    """Write an image as it is after the deformation, on its own grid or that of another image.

    `image`: its file, of the body before the deformation; `labels`: whether values are labels, of which a voxel takes
    the one with the largest linear weight (with several components the nearest voxel's), not those of a volume, which
    are interpolated linearly. Voxels that come from outside the image get its smallest value, labels zero. Names and
    colours of segments are kept.
    """
    out, kind = place("path", path), flag("labels", labels)
    ending(out)
    for name, other in {"image": image, **({} if like is None else {"like": like})}.items():
        if place(name, other, error=FormatError).resolve() == out.resolve():
            message = f"`path` must be another file than `{name}`, got '{out}' for both"
            raise ArgumentError(message, where="path")
    sitk, source = itk(), read_image(image)
    grid = Grid.of(source if like is None else read_image(like))
    sampled = Sampled(field.space, grid, back=True, threads=threads)
    several = source.GetNumberOfComponentsPerPixel() > 1
    chosen = _Labels.of(source) if kind and not several else None
    empty = 0.0 if kind or several else _least(source)
    how = sitk.sitkNearestNeighbor if kind else sitk.sitkLinear, empty, threads
    parts, tally = [], Tally()
    for some, moved in sampled.slabs(tally):
        if chosen is None:
            parts.append(_resampled(source, grid, moved, some.start, how))
        else:
            parts.append(chosen.at(grid, moved, some.start, threads))
    if not tally.inside:
        message = "the image must show the body; none of its voxels lies there: check the frames"
        raise ArgumentError(message, where=str(image))
    found = grid.image(np.concatenate(parts))
    for key in source.GetMetaDataKeys():
        # Extents of segments are those of before the motion, and of another grid.
        if key.endswith("_Extent"):
            found.SetMetaData(key, " ".join(f"0 {n - 1}" for n in grid.size))
        elif key.startswith("Segment") and not key.endswith(("ExtentOffset", "ConversionParameters")):
            found.SetMetaData(key, source.GetMetaData(key))
    write_image(out, found)
    return Warped(tally.moved_mm, tally.outside, sampled.residual_mm())


def section_of(space: SpaceMap, source: Any, grid: Grid) -> tuple[FloatArray, BoolArray]:
    """Return a SimpleITK volume as it is after the deformation of `space` on a grid of one slice, (rows, columns).

    Places that come from outside the image get its smallest value. Second: which places are inside the body.
    """
    moved, by = Sampled(space, grid, back=True).slices(0, 1)
    found = _resampled(source, grid, moved, 0, (itk().sitkLinear, _least(source), 0))
    return np.asarray(found[0], np.float64), by[0] == Mark.INSIDE


@dataclass(frozen=True, eq=False)
class _Labels:
    """A label map that is read between its voxels: each point takes the label with the largest linear weight.

    `coded`: image of twice the label, and one more where a neighbour has another; `values`: its labels; `grid`: their
    places.
    """

    coded: Any
    values: npt.NDArray[Any]
    grid: Grid

    @classmethod
    def of(cls, image: Any) -> "_Labels":
        """Return the labels of an image; raise `ArgumentError` if they are no whole numbers."""
        from scipy import ndimage

        sitk = itk()
        values = labels_of(image, "labels", ArgumentError)
        mixed = ndimage.minimum_filter(values, 3) != ndimage.maximum_filter(values, 3)
        coded = sitk.GetImageFromArray(2 * values.astype(np.int64 if values.dtype.itemsize > 2 else np.int32) + mixed)
        coded.CopyInformation(image)
        return cls(coded, values, Grid.of(image))

    def at(self, grid: Grid, moved: Any, first: int, threads: int = 0) -> npt.NDArray[Any]:
        """Return the labels of some slices (n, rows, columns), whose voxels come from `moved` (..., 3) away."""
        found = _resampled(self.coded, grid, moved, first, (itk().sitkNearestNeighbor, 0.0, threads))
        labels, mixed = (found >> 1).astype(self.values.dtype), np.argwhere(found & 1)
        came = grid.places(mixed[:, ::-1] + [0.0, 0.0, first]) + moved[tuple(mixed.T)]
        at = self.grid.indices(came)
        low = np.floor(at).astype(int)
        corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
        weights = np.prod(np.where(corners, (at - low)[:, None], 1.0 - (at - low)[:, None]), axis=2)
        numbers = np.clip(low[:, None] + corners, 0, np.array(self.grid.size) - 1)
        around = self.values[numbers[..., 2], numbers[..., 1], numbers[..., 0]]
        shares = np.stack([np.sum(weights * (around == around[:, k : k + 1]), axis=1) for k in range(8)], axis=1)
        labels[tuple(mixed.T)] = around[np.arange(len(mixed)), shares.argmax(axis=1)]
        return np.asarray(labels)


def _least(image: Any) -> float:
    """Return the smallest value of a volume; raise `ArgumentError` if all are NaN or infinite."""
    values = itk().GetArrayViewFromImage(image)
    least = (
        float(np.min(values, where=np.isfinite(values), initial=np.inf)) if values.dtype.kind == "f" else values.min()
    )
    if not np.isfinite(least):
        message = "a volume must have a voxel with a finite value, got none"
        raise ArgumentError(message, where="image")
    return float(least)


def _resampled(source: Any, grid: Grid, moved: Any, first: int, how: tuple[Any, float, int]) -> Any:
    """Return some slices (n, rows, columns) of an image whose voxels come from `moved` (n, rows, columns, 3) away.

    `how`: interpolator, value outside the image, threads.
    """
    sitk, (between, empty, threads) = itk(), how
    # The transform interpolates its field, which needs two slices at least; at voxels it is exact.
    padded = np.concatenate([moved, moved[-1:]]) if len(moved) == 1 else moved
    transform = sitk.DisplacementFieldTransform(grid.image(padded.astype(np.float64), first))
    place = grid.image(np.zeros(moved.shape[:3], np.uint8), first)
    resampling = threaded("ResampleImageFilter", threads)
    resampling.SetReferenceImage(place)
    resampling.SetTransform(transform)
    resampling.SetInterpolator(between)
    resampling.SetDefaultPixelValue(empty)
    resampling.SetOutputPixelType(source.GetPixelID())
    return sitk.GetArrayFromImage(resampling.Execute(source))


__all__ = ["Warped", "section_of", "warp_image", "warp_points", "warp_surface"]
