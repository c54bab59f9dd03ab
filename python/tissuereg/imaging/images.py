"""Image files, by SimpleITK: NRRD (.seg.nrrd too), NIfTI, MetaImage, DICOM and others; lengths in mm, frame LPS."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError, MissingPackageError, TissueRegError
from tissuereg.imaging.dicom import dicom_kind, read_segmentation, read_series
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import existing_file

#: Endings of names that are written, in lower case.
WRITTEN = (".nrrd", ".nhdr", ".nii", ".nii.gz", ".mha", ".mhd")


def itk() -> Any:
    """Return the module SimpleITK; raise `MissingPackageError` if it is not installed."""
    try:
        import SimpleITK
    except ImportError as error:
        message = "images are read and written by SimpleITK, which must be installed: pip install 'tissuereg[images]'"
        raise MissingPackageError(message, where="SimpleITK") from error
    return SimpleITK


def threaded(kind: str, threads: int) -> Any:
    """Return a filter of SimpleITK, by the name of its class, that runs in some threads; 0 takes all cores."""
    made = getattr(itk(), kind)()
    if threads:
        made.SetNumberOfThreads(threads)
    return made


def read_image(path: str | os.PathLike[str]) -> Any:
    """Return a SimpleITK image of three dimensions; raise `FormatError` if the file is missing or holds none.

    `path`: a file, or the folder of a DICOM series.
    """
    sitk = itk()
    if place("path", path, error=FormatError).is_dir():
        return read_series(Path(path), sitk)
    file = existing_file(path)
    if (kind := dicom_kind(file)) == "segmentation":
        return read_segmentation(file, sitk)
    if kind is not None:
        message = f"of a DICOM series the folder must be given, with one slice a file; got the file {file}"
        raise FormatError(message, where=str(file))
    try:
        image = sitk.ReadImage(str(file))
    except RuntimeError as error:
        words = " ".join(str(error).split())
        message = f"{file} must be an image that SimpleITK reads (.nrrd, .nii.gz, .mha ...); {words[-300:]}"
        raise FormatError(message, where=str(file)) from error
    if image.GetDimension() != 3 or min(image.GetSize()) < 1:
        message = f"{file} must hold a volume of three dimensions, got size {image.GetSize()}"
        raise FormatError(message, where=str(file))
    if "complex" in image.GetPixelIDTypeAsString():
        message = f"{file} must hold real numbers, got {image.GetPixelIDTypeAsString()}"
        raise FormatError(message, where=str(file))
    return image


def labels_of(image: Any, name: str, error: type[TissueRegError]) -> npt.NDArray[Any]:
    """Return the labels of an image, (slices, rows, columns); raise `error` if they are no whole numbers."""
    values = np.asarray(itk().GetArrayFromImage(image))
    largest = max(float(values.max()), -float(values.min()))
    # Beyond it not every whole number is a float64.
    if not largest < 2.0**53 or (values.dtype.kind == "f" and not np.array_equal(values, np.rint(values))):
        message = f"{name} must hold labels, whole numbers below 2^53; an image of other values is a volume"
        raise error(message, where=name)
    return values


def write_image(path: str | os.PathLike[str], image: Any) -> Path:
    """Write a SimpleITK image, whole or not at all, compressed where its format can be."""
    sitk, target = itk(), Path(path)
    ending(target)
    with atomic_file(target) as draft:  # of the same name, which tells the format
        try:
            sitk.WriteImage(image, str(draft), useCompression=True)
        except RuntimeError as error:
            message = f"{target} cannot be written as an image: {' '.join(str(error).split())[-300:]}"
            raise FormatError(message, where=str(target)) from error
    return target


def ending(path: str | os.PathLike[str]) -> str:
    """Return the ending of an image's name; raise `FormatError` if none of those that are written in one file."""
    name = Path(path).name.lower()
    found = [one for one in WRITTEN if name.endswith(one)]
    if not found or found[-1] in (".nhdr", ".mhd"):
        wanted = ", ".join(one for one in WRITTEN if one not in (".nhdr", ".mhd"))
        message = f"an image's name must end in one of {wanted}, got '{path}'"
        raise FormatError(message, where=str(path))
    return found[-1]


@dataclass(frozen=True, eq=False)
class Grid:
    """The grid of an image: places of voxels in LPS, mm.

    `size`: voxels along each axis of the image; `origin` (3,): place of the first; `steps` (3, 3): columns are the
    steps from voxel to voxel along each axis.
    """

    size: tuple[int, int, int]
    origin: FloatArray
    steps: FloatArray

    @classmethod
    def of(cls, image: Any) -> "Grid":
        """Return the grid of a SimpleITK image."""
        steps = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
        return cls(tuple(image.GetSize()), np.array(image.GetOrigin()), steps)

    @classmethod
    def over(cls, low: FloatArray, high: FloatArray, spacing: float) -> "Grid":
        """Return a grid along the axes over a box, mm."""
        counts = np.ceil((high - low) / spacing).astype(int) + 1
        middle = 0.5 * (low + high) - 0.5 * spacing * (counts - 1)
        return cls((int(counts[0]), int(counts[1]), int(counts[2])), middle, spacing * np.eye(3))

    @property
    def spacing(self) -> FloatArray:
        """Length of the step along each axis, (3,), mm."""
        return np.asarray(np.linalg.norm(self.steps, axis=0))

    def indices(self, places: FloatArray) -> FloatArray:
        """Return places (n, 3) in LPS, mm, as column, row and slice of the grid, not rounded."""
        return np.ascontiguousarray(np.linalg.solve(self.steps, (places - self.origin).T).T)

    def places(self, indices: FloatArray) -> FloatArray:
        """Return the places (n, 3) in LPS, mm, of columns, rows and slices (n, 3)."""
        return np.asarray(self.origin + indices @ self.steps.T)

    def image(self, values: Any, first: int = 0) -> Any:
        """Return values (slices, rows, columns) or (..., n), from slice `first` on, as a SimpleITK image."""
        sitk = itk()
        image = sitk.GetImageFromArray(values, isVector=values.ndim == 4)
        image.SetOrigin([float(x) for x in self.places(np.array([[0.0, 0.0, first]]))[0]])
        image.SetSpacing([float(x) for x in self.spacing])
        image.SetDirection([float(x) for x in (self.steps / self.spacing).ravel()])
        return image


__all__ = ["Grid", "ending", "itk", "labels_of", "read_image", "threaded", "write_image"]
