"""The surface of a label in a segmentation, without the steps of its voxels, and which tets lie in which label.

The label's voxels are turned into a signed distance, smoothed by a voxel along each axis; the surface is where that is
zero.
"""

import os
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import each, found
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshingError, MissingPackageError
from tissuereg.imaging.images import WRITTEN, Grid, itk, read_image
from tissuereg.meshing.settings import MESHING


def is_segmentation(path: str | os.PathLike[str]) -> bool:
    """Return whether the name of a file is that of an image."""
    return str(path).lower().endswith(WRITTEN)


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Labels of an image.

    `path`: its file; `grid`: places of its voxels; `values` (slices, rows, columns): the label of each; `labels`: the
    value of each label that is asked for, by name or number.
    """

    path: str
    grid: Grid
    values: npt.NDArray[Any]
    labels: dict[str, int]

    @classmethod
    def read(cls, path: str | os.PathLike[str], labels: Any) -> "Segmentation":
        """Read a label map; `labels`: names (of a .seg.nrrd's segments) or numbers of the labels that make the body."""
        image = read_image(path)
        if image.GetNumberOfComponentsPerPixel() != 1:
            message = f"{path} must hold one label a voxel; segments of it overlap: export it as a label map"
            raise MeshingError(message, where=str(path))
        sitk = itk()
        values = sitk.GetArrayFromImage(image)
        if values.dtype.kind not in "iu":
            if not np.array_equal(values, np.rint(values)):
                message = f"{path} must hold labels, whole numbers, got dtype {values.dtype}"
                raise MeshingError(message, where=str(path))
            values = values.astype(np.int64)
        named = _segments(image)
        there = {int(one) for one in np.unique(values)} - {0}
        chosen: dict[str, int] = {}
        for asked in each("labels", labels, object, error=MeshingError):
            value = named.get(str(asked), _number(asked))
            if value is None or value not in there:
                listed = [f"{name} ({one})" for name, one in named.items() if one in there]
                listed = listed or [str(one) for one in sorted(there)]
                message = f"`labels` must be labels in {path}: {', '.join(listed) or 'it has none'}; got {found(asked)}"
                raise MeshingError(message, where="labels")
            chosen[str(asked)] = value
        if not chosen:
            message = "`labels` must name at least one label, got none"
            raise MeshingError(message, where="labels")
        return cls(str(path), Grid.of(image), values, chosen)

    def surface(self) -> tuple[Triangles, list[str]]:
        """Return the surface around all labels together, in LPS, mm, and what was done to the voxels, in sentences."""
        inside = np.isin(self.values, list(self.labels.values()))
        inside, said = _mended(inside, float(np.prod(self.grid.spacing)))
        faces = [inside[[0, -1]], inside[:, [0, -1]], inside[:, :, [0, -1]]]
        if any(face.any() for face in faces):
            said.append("the label reaches the border of the image, where the surface is cut off")
        sitk = itk()
        image = sitk.GetImageFromArray(np.pad(inside, 3).astype(np.uint8))
        image.SetSpacing([float(x) for x in self.grid.spacing])
        # Distances are from middles of voxels at the border: the mean of both ways is zero between them.
        apart = partial(sitk.SignedMaurerDistanceMap, squaredDistance=False, useImageSpacing=True)
        distance = 0.5 * (apart(image) - apart(1 - image))
        smooth = sitk.GetArrayFromImage(
            sitk.SmoothingRecursiveGaussian(distance, [float(x) for x in self.grid.spacing])
        )
        vertices, triangles = _contour(smooth)
        # Normals point to smaller values, and the axes of an image may be left-handed.
        if np.linalg.det(self.grid.steps) > 0.0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        return Triangles(self.grid.places(vertices - 3.0), triangles, "LPS"), said

    def of_tets(self, nodes: FloatArray, tets: IntArray, volumes: FloatArray) -> dict[str, dict[str, float]]:
        """Return number and volume, mm^3, of the tets whose middle lies in each label; the rest is in none."""
        middle = np.rint(self.grid.indices(nodes[tets].mean(axis=1))).astype(int)
        middle = np.clip(middle, 0, np.array(self.grid.size) - 1)
        own = self.values[middle[:, 2], middle[:, 1], middle[:, 0]]
        return {
            name: {"tets": int(np.count_nonzero(own == value)), "volume_mm3": float(volumes[own == value].sum())}
            for name, value in self.labels.items()
        }


def _number(word: Any) -> int | None:
    try:
        return int(str(word))
    except ValueError:
        return None


def _segments(image: Any) -> dict[str, int]:
    """Return the label of each segment that a .seg.nrrd names."""
    named, number = {}, 0
    while image.HasMetaDataKey(f"Segment{number}_Name"):
        value = f"Segment{number}_LabelValue"
        named[image.GetMetaData(f"Segment{number}_Name").strip()] = (
            int(image.GetMetaData(value)) if image.HasMetaDataKey(value) else number + 1
        )
        number += 1
    return named


def _mended(inside: npt.NDArray[np.bool_], voxel_mm3: float) -> tuple[npt.NDArray[np.bool_], list[str]]:
    """Return voxels without small islands and with small cavities filled, and what was done."""
    from scipy import ndimage

    said: list[str] = []
    parts, n_parts = ndimage.label(inside)
    sizes = np.bincount(parts.ravel())[1:]
    small = np.flatnonzero(sizes < MESHING.least_island * sizes.max())
    if len(small):
        inside = inside & ~np.isin(parts, 1 + small)
        said.append(f"{len(small)} islands, together {sizes[small].sum() * voxel_mm3:.3g} mm^3, were left out")
    if n_parts - len(small) > 1:
        said.append(f"the label has {n_parts - len(small)} parts")
    cavities, _ = ndimage.label(~np.pad(inside, 1))
    sizes = np.bincount(cavities.ravel())
    outer = cavities[0, 0, 0]
    closed = [k for k in range(1, len(sizes)) if k != outer and sizes[k] < MESHING.most_cavity * inside.sum()]
    if closed:
        inside = inside | np.isin(cavities, closed)[1:-1, 1:-1, 1:-1]
        said.append(f"{len(closed)} cavities, together {sizes[closed].sum() * voxel_mm3:.3g} mm^3, were filled")
    return inside, said


def _contour(values: npt.NDArray[Any]) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3), in columns, rows and slices, and triangles where values are zero."""
    try:
        import pyvista
    except ImportError as error:
        message = "surfaces of labels are made by pyvista, which must be installed: pip install 'tissuereg[mesh]'"
        raise MissingPackageError(message, where="pyvista") from error
    image = pyvista.ImageData(dimensions=values.shape[::-1])
    made = image.contour([0.0], scalars=values.ravel(), method="flying_edges")
    if not made.n_points:
        message = "the labels must have an inside larger than a voxel; no surface was found"
        raise MeshingError(message, where="labels")
    return np.asarray(made.points, np.float64), np.asarray(made.faces.reshape(-1, 4)[:, 1:], np.int64)


__all__ = ["Segmentation", "is_segmentation"]
