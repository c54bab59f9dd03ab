"""DICOM: a folder with the slices of a series, by SimpleITK, and segmentations (SEG), by pydicom; mm, LPS.

Slices are put in order by their places, which must be evenly spaced along the normal: what an image cannot say, a
tilted gantry or a lost slice, is refused.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError, MissingPackageError


class Tags(NamedTuple):
    """Where a file says what it is, and how exactly its slices must lie.

    `magic`: a DICOM file, from byte 128 on; `of_segmentation`: the kinds SEG and label map SEG, in its first `head`
    bytes; `description`, `slope`, `intercept`: keys of a slice; `off`: the share of a step by which it may be off.
    """

    magic: bytes = b"DICM"
    of_segmentation: tuple[bytes, ...] = (b"1.2.840.10008.5.1.4.1.1.66.4", b"1.2.840.10008.5.1.4.1.1.66.7")
    head: int = 1024
    description: str = "0008|103e"
    slope: str = "0028|1053"
    intercept: str = "0028|1052"
    off: float = 0.1


TAGS = Tags()


def dicom_kind(file: Path) -> str | None:
    """Return "segmentation" or "other" for a DICOM file, None for what is none."""
    with file.open("rb") as stream:
        head = stream.read(TAGS.head)
    if head[128:132] != TAGS.magic:
        return None
    return "segmentation" if any(kind in head for kind in TAGS.of_segmentation) else "other"


def read_series(folder: Path, sitk: Any) -> Any:
    """Return the slices in a folder as an image of SimpleITK, the module `sitk`; raise `FormatError` if it has no grid.

    Values are rescaled; where slices do so differently they become float32.
    """
    reader, found = sitk.ImageSeriesReader, {}
    for one in reader.GetGDCMSeriesIDs(str(folder)):
        files = list(reader.GetGDCMSeriesFileNames(str(folder), one))
        if dicom_kind(Path(files[0])) != "segmentation" and (first := _head(files[0], sitk)) is not None:
            found[one] = (files, first)
    if len(found) != 1:
        listed = "; ".join(f"{_said(first, TAGS.description)!r}, {len(files)} files" for files, first in found.values())
        message = f"the folder {folder} must hold one DICOM series of slices, got {len(found)}{listed and ': '}{listed}"
        raise FormatError(message, where=str(folder))
    ((files, first),) = found.values()
    heads = [head for file in files if (head := _head(file, sitk)) is not None]
    layouts = {(head.GetSize(), tuple(np.round([*head.GetSpacing()[:2], *head.GetDirection()], 4))) for head in heads}
    if len(heads) != len(files) or len(layouts) != 1 or first.GetSize()[2] != 1:
        message = f"the slices of {folder} must all have one size, spacing and orientation, one slice a file"
        raise FormatError(message, where=str(folder))
    direction = np.array(first.GetDirection()).reshape(3, 3)
    order, step = _evenly(np.array([head.GetOrigin() for head in heads]), direction[:, 2], folder)
    reading = reader()
    reading.SetFileNames([files[k] for k in order])
    scales = {(_said(head, TAGS.slope) or "1", _said(head, TAGS.intercept) or "0") for head in heads}
    if len(scales) > 1:
        reading.SetOutputPixelType(sitk.sitkFloat32)
    image = reading.Execute()
    return _placed(image, heads[order[0]].GetOrigin(), [*first.GetSpacing()[:2], step], direction)


def read_segmentation(file: Path, sitk: Any) -> Any:
    """Return a DICOM segmentation as a label map of SimpleITK, the module `sitk`, that names its segments.

    A slice without labels is put before the first and behind the last, since empty ones are often not stored.
    """
    pydicom = _pydicom()
    try:
        data = pydicom.dcmread(file)
        frames = np.asarray(data.pixel_array).reshape(-1, int(data.Rows), int(data.Columns))
        kind = str(data.SegmentationType)
        planes = [_Plane.of(frame, data) for frame in data.PerFrameFunctionalGroupsSequence]
        names = {int(one.SegmentNumber): str(one.SegmentLabel) for one in data.SegmentSequence}
    except Exception as error:  # whatever a spoilt file makes pydicom raise
        message = f"{file} cannot be read as a DICOM segmentation: {' '.join(str(error).split())[-300:]}"
        raise FormatError(message, where=str(file)) from error
    if kind not in ("BINARY", "LABELMAP"):
        message = f"{file} must be a binary segmentation or a label map, got {kind}"
        raise FormatError(message, where=str(file))
    if len({(one.direction, one.spacing) for one in planes}) != 1 or len(planes) != len(frames):
        message = f"the frames of {file} must all have one spacing and orientation"
        raise FormatError(message, where=str(file))
    across, down = np.array(planes[0].direction).reshape(2, 3)
    normal = np.cross(across, down)
    numbers, first, step = _rows_of([one.origin for one in planes], normal, planes[0].apart, file)
    values = np.zeros((int(numbers.max()) + 3, *frames.shape[1:]), np.uint16)
    for number, plane, frame in zip(numbers + 1, planes, frames, strict=True):
        inside = frame > 0
        if (values[number][inside] > 0).any():
            message = f"segments of {file} overlap: export them as a label map"
            raise FormatError(message, where=str(file))
        values[number][inside] = frame[inside] if kind == "LABELMAP" else plane.segment
    image = sitk.GetImageFromArray(values)
    for k, (value, name) in enumerate(sorted(names.items())):
        image.SetMetaData(f"Segment{k}_Name", name)
        image.SetMetaData(f"Segment{k}_LabelValue", str(value))
    direction = np.column_stack([across, down, normal])
    return _placed(image, first - step * normal, [*planes[0].spacing, step], direction)


class _Plane(NamedTuple):
    """A frame of a segmentation: place, axes, spacing along them, mm, number of its segment.

    `apart`: distance of slices and their thickness, mm, 0 where it is not stated.
    """

    origin: tuple[float, ...]
    direction: tuple[float, ...]
    spacing: tuple[float, ...]
    apart: tuple[float, float]
    segment: int

    @classmethod
    def of(cls, frame: Any, data: Any) -> "_Plane":
        shared = data.SharedFunctionalGroupsSequence[0]

        def group(name: str) -> Any:
            return getattr(frame if hasattr(frame, name) else shared, name)[0]

        measures, labelled = group("PixelMeasuresSequence"), data.SegmentationType != "LABELMAP"
        between, thickness = (getattr(measures, name, None) for name in ("SpacingBetweenSlices", "SliceThickness"))
        down, across = measures.PixelSpacing
        return cls(
            tuple(map(float, group("PlanePositionSequence").ImagePositionPatient)),
            tuple(map(float, group("PlaneOrientationSequence").ImageOrientationPatient)),
            (float(across), float(down)),
            (float(between or 0.0), float(thickness or 0.0)),
            int(group("SegmentIdentificationSequence").ReferencedSegmentNumber) if labelled else 0,
        )


def _pydicom() -> Any:
    try:
        import pydicom
    except ImportError as error:
        message = "DICOM segmentations are read by pydicom, which must be installed: pip install 'tissuereg[dicom]'"
        raise MissingPackageError(message, where="pydicom") from error
    return pydicom


def _head(file: str, sitk: Any) -> Any:
    """Return a reader that knows what the header of an image says, None where there is no image."""
    reader = sitk.ImageFileReader()
    reader.SetFileName(file)
    try:
        reader.ReadImageInformation()
    except RuntimeError:
        return None
    return reader if len(reader.GetSize()) == 3 else None


def _said(head: Any, key: str) -> str:
    return str(head.GetMetaData(key)).strip() if head.HasMetaDataKey(key) else ""


def _evenly(places: FloatArray, normal: FloatArray, where: Path) -> tuple[IntArray, float]:
    """Return the order of slices along their normal, and their step, mm, after checking that it is one."""
    along = places @ normal
    order = np.argsort(along, kind="stable")
    step = float(np.ptp(along)) / max(len(places) - 1, 1)
    if not step > 0.0:
        message = f"{where} must hold two slices or more, at different places, got {len(places)}"
        raise FormatError(message, where=str(where))
    _check_places(places[order], np.arange(len(places)), step * normal, where)
    return order, step


def _rows_of(
    origins: Sequence[tuple[float, ...]], normal: FloatArray, stated: tuple[float, float], where: Path
) -> tuple[IntArray, FloatArray, float]:
    """Return the slice of every frame, the place of the first, mm, and the step, after checking that it is one."""
    places = np.array(origins)
    along = places @ normal
    gaps = np.diff(np.unique(np.round(along, 4)))
    least = gaps.min(initial=np.inf)
    # Frames without labels may be left out: then the least gap is not the step. Slices may be thinner than that.
    between, thickness = stated
    steps = (between, least if len(gaps) > 1 else 0.0, thickness)
    fits = [one for one in steps if one > 0.0 and np.allclose(gaps / one, np.rint(gaps / one), atol=TAGS.off)]
    step = float(fits[0] if fits else least)
    first = places[along.argmin()]
    if not np.isfinite(step):
        message = f"{where} must state how far apart slices are"
        raise FormatError(message, where=str(where))
    numbers = np.rint((along - along.min()) / step).astype(np.int64)
    _check_places(np.array([first, *places]), np.array([0, *numbers]), step * normal, where)
    return numbers, first, step


def _check_places(places: FloatArray, numbers: IntArray, step: FloatArray, where: Path) -> None:
    off = places - places[0] - numbers[:, None] * step
    length = float(np.linalg.norm(step))
    along = np.abs(off @ step) / length
    if along.max() > TAGS.off * length:
        worst = int(along.argmax())
        message = (
            f"slices of {where} must be evenly spaced, by {length:.4g} mm as it seems; slice {worst} in order lies "
            f"{along[worst]:.3g} mm off: one is missing, doubled, or of another series"
        )
        raise FormatError(message, where=str(where))
    aside = float(np.linalg.norm(off - np.outer(off @ step, step) / length**2, axis=1).max())
    if aside > TAGS.off * length:
        message = (
            f"slices of {where} must lie above one another along their normal, got {aside:.3g} mm aside: of a tilted "
            "gantry the volume must be resampled first"
        )
        raise FormatError(message, where=str(where))


def _placed(image: Any, origin: Any, spacing: Sequence[float], direction: npt.NDArray[Any]) -> Any:
    image.SetOrigin([float(x) for x in origin])
    image.SetSpacing([float(x) for x in spacing])
    image.SetDirection([float(x) for x in np.asarray(direction).ravel()])
    return image


__all__ = ["dicom_kind", "read_segmentation", "read_series"]
