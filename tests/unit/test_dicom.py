"""DICOM: series are put in order and refused where they have no grid; segmentations are those of another writer."""

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 (its own habit)

from tissuereg.errors import FormatError, MeshingError, MissingPackageError
from tissuereg.imaging.images import Grid, read_image, write_image
from tissuereg.meshing.segmentation import Segmentation

TURN = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 0.8, 0.2], [0.1, -0.3, 1.0]]))[0]
TURN = TURN * np.sign(np.linalg.det(TURN))
SIZE = (24, 20, 9)
GRID = Grid(SIZE, np.array([-30.0, 12.5, 101.25]), TURN * [0.75, 0.75, 2.5])
CT, SEG = "1.2.840.10008.5.1.4.1.1.2", "1.2.826.0.1.3680043.2.1125."


def values():
    return np.random.default_rng(0).integers(-900, 1500, SIZE[::-1]).astype(np.int16)


def write_slices(folder, *, places=None, series="1", slices=None, spacing=0.75, thickness="2.5"):
    """Write a CT series, each slice a file, whose names are in another order than their places."""
    folder.mkdir(exist_ok=True)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    order = np.random.default_rng(1).permutation(SIZE[2])
    for k in range(SIZE[2]) if slices is None else slices:
        image = sitk.GetImageFromArray(values()[k][None])  # stored without its intercept
        place = GRID.places(np.array([[0.0, 0.0, k]]))[0] if places is None else places[k]
        of_slice = {
            "0008|0016": CT,
            "0008|0018": f"{SEG}{series}.{k + 1}",
            "0008|0060": "CT",
            "0008|103e": f"series {series}",
            "0010|0010": "Nobody^",
            "0010|0020": "1",
            "0020|000d": f"{SEG}99",
            "0020|000e": f"{SEG}{series}",
            "0020|0013": str(k + 1),
            "0020|0032": "\\".join(f"{x:.9g}" for x in place),
            "0020|0037": "\\".join(f"{x:.9g}" for x in TURN[:, :2].T.ravel()),
            "0020|0052": f"{SEG}98",
            "0028|1052": "-1024",
            "0028|1053": "1",
            "0018|0050": thickness,
        }
        image.SetSpacing((spacing, spacing, 2.5))
        for key, value in of_slice.items():
            image.SetMetaData(key, value)
        writer.SetFileName(str(folder / f"{series}-{order[k]:03}.dcm"))
        writer.Execute(image)
    return folder


def test_a_series_is_read_in_the_order_of_its_places_with_its_values(tmp_path):
    image = read_image(write_slices(tmp_path / "ct"))
    assert np.array_equal(sitk.GetArrayFromImage(image), values())
    grid = Grid.of(image)
    assert grid.size == SIZE
    assert grid.origin == pytest.approx(GRID.origin, abs=1e-5)
    assert grid.steps == pytest.approx(GRID.steps, abs=1e-5)


def test_slices_that_stand_the_other_way_round_are_turned(tmp_path):
    down = [GRID.places(np.array([[0.0, 0.0, -k]]))[0] for k in range(SIZE[2])]
    image = read_image(write_slices(tmp_path / "down", places=down))
    assert np.array_equal(sitk.GetArrayFromImage(image), values()[::-1])
    assert Grid.of(image).origin == pytest.approx(down[-1], abs=1e-5)


def test_slices_may_have_other_scales(tmp_path):
    pydicom = pytest.importorskip("pydicom", reason="changes the scales")
    folder = write_slices(tmp_path / "ct")
    slopes = 1.0 + 0.25 * np.arange(SIZE[2])
    for file in folder.iterdir():
        data = pydicom.dcmread(file)
        data.RescaleSlope = slopes[int(data.InstanceNumber) - 1]
        data.save_as(file)
    wanted = slopes[:, None, None] * (values() + 1024.0) - 1024.0
    assert sitk.GetArrayFromImage(read_image(folder)) == pytest.approx(wanted, abs=1e-3)


def test_what_has_no_grid_is_refused(tmp_path):
    even = GRID.places(np.column_stack([np.zeros((9, 2)), np.arange(9.0)]))
    tilted = even + np.outer(np.arange(9.0), 0.3 * TURN[:, 1])
    doubled = even[[0, 1, 2, 2, 3, 4, 5, 6, 7]]
    cases = {
        "evenly spaced": {"slices": [0, 1, 2, 4, 5, 6, 7, 8]},
        "doubled": {"places": doubled},
        "tilted gantry": {"places": tilted},
        "two slices or more": {"slices": [3]},
    }
    for number, (said, options) in enumerate(cases.items()):
        with pytest.raises(FormatError, match=said):
            read_image(write_slices(tmp_path / str(number), **options))
    folder = write_slices(tmp_path / "mixed", slices=[0, 1, 2])
    with pytest.raises(FormatError, match="one size, spacing and orientation"):
        read_image(write_slices(folder, slices=[3, 4, 5], spacing=0.8))
    folder = write_slices(tmp_path / "two", slices=[0, 1, 2])
    with pytest.raises(FormatError, match="got 2: 'series 1', 3 files; 'series 2', 2 files"):
        read_image(write_slices(folder, series="2", slices=[3, 4]))
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "notes.txt").write_text("no image", encoding="utf-8")
    with pytest.raises(FormatError, match="got 0"):
        read_image(tmp_path / "none")
    with pytest.raises(FormatError, match="the folder must be given"):
        read_image(next(folder.iterdir()))


def segmented(hd, folder, path, masks, *, kind="BINARY", sparse=True):
    """Write a segmentation of a series by highdicom; `masks`: voxels of each segment."""
    import pydicom

    slices = sorted((pydicom.dcmread(file) for file in folder.iterdir()), key=lambda one: int(one.InstanceNumber))
    organ = pydicom.sr.codedict.codes.SCT.Organ
    told = [
        hd.seg.SegmentDescription(k + 1, name, organ, organ, hd.seg.SegmentAlgorithmTypeValues.MANUAL)
        for k, name in enumerate(masks)
    ]
    every = np.stack(list(masks.values()), axis=-1).astype(np.uint8)
    made = hd.seg.Segmentation(
        source_images=slices,
        pixel_array=every,
        segmentation_type=kind,
        segment_descriptions=told,
        series_instance_uid=hd.UID(),
        series_number=5,
        sop_instance_uid=hd.UID(),
        instance_number=1,
        manufacturer="nobody",
        manufacturer_model_name="none",
        software_versions="1",
        device_serial_number="1",
        omit_empty_frames=sparse,
    )
    made.save_as(path)
    return path


def two_masks():
    z, y, x = np.indices(SIZE[::-1])
    organ = (np.abs(z - 4) < 4) & (np.abs(y - 10) < 8) & (np.abs(x - 12) < 9) & (z != 3)
    tumour = organ & (np.abs(x - 8) < 3) & (z < 6)
    return {"liver": organ & ~tumour, "a tumour": tumour}


@pytest.mark.parametrize(("kind", "sparse"), [("BINARY", True), ("BINARY", False), ("LABELMAP", True)])
def test_a_segmentation_of_another_writer_lies_where_its_series_does(tmp_path, kind, sparse):
    hd = pytest.importorskip("highdicom", reason="writes the segmentations")
    masks = two_masks()
    path = segmented(hd, write_slices(tmp_path / "ct"), tmp_path / "seg.dcm", masks, kind=kind, sparse=sparse)
    found = Segmentation.read(path, ["liver", "a tumour"])
    assert found.labels == {"liver": 1, "a tumour": 2}
    for mask, value in zip(masks.values(), (1, 2), strict=True):
        wanted = GRID.places(np.argwhere(mask)[:, ::-1].astype(float))
        places = found.grid.places(np.argwhere(found.values == value)[:, ::-1].astype(float))
        assert places == pytest.approx(wanted, abs=1e-4)
    if kind == "BINARY" and sparse:
        surface, said = Segmentation.read(path, ["a tumour"]).surface()
        assert surface.volume == pytest.approx(masks["a tumour"].sum() * 0.75 * 0.75 * 2.5, rel=0.01)
        assert not any("border" in words for words in said)


@pytest.mark.parametrize("thickness", ["1.25", "5"])
def test_slices_of_a_segmentation_may_be_thinner_or_thicker_than_they_are_apart(tmp_path, thickness):
    hd = pytest.importorskip("highdicom", reason="writes the segmentations")
    pydicom = pytest.importorskip("pydicom")
    path = segmented(hd, write_slices(tmp_path / "ct", thickness=thickness), tmp_path / "seg.dcm", two_masks())
    data = pydicom.dcmread(path)
    measures = data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
    if "SpacingBetweenSlices" in measures:
        del measures.SpacingBetweenSlices
    measures.SliceThickness = thickness
    data.save_as(path)
    found = Segmentation.read(path, ["liver"])
    assert np.linalg.norm(found.grid.steps, axis=0) == pytest.approx([0.75, 0.75, 2.5], abs=1e-4)


def test_overlapping_and_fractional_segments_are_refused(tmp_path):
    hd = pytest.importorskip("highdicom", reason="writes the segmentations")
    masks, folder = two_masks(), write_slices(tmp_path / "ct")
    masks["liver"] |= masks["a tumour"]
    with pytest.raises(FormatError, match="overlap"):
        Segmentation.read(segmented(hd, folder, tmp_path / "both.dcm", masks), ["liver"])
    path = segmented(hd, folder, tmp_path / "parts.dcm", two_masks(), kind="FRACTIONAL")
    with pytest.raises(FormatError, match="got FRACTIONAL"):
        Segmentation.read(path, ["liver"])
    path = segmented(hd, folder, tmp_path / "seg.dcm", two_masks())
    with pytest.raises(MeshingError, match=r"liver \(1\), a tumour \(2\); got 'spleen'"):
        Segmentation.read(path, ["spleen"])
    (tmp_path / "spoilt.dcm").write_bytes(path.read_bytes()[:1500])
    with pytest.raises(FormatError, match="cannot be read as a DICOM segmentation"):
        Segmentation.read(tmp_path / "spoilt.dcm", ["liver"])


def test_without_pydicom_its_install_line_is_named(tmp_path, monkeypatch):
    head = b"\0" * 128 + b"DICM" + b"\2\0\2\0UI\x1c\0" + b"1.2.840.10008.5.1.4.1.1.66.4"
    (tmp_path / "seg.dcm").write_bytes(head)
    monkeypatch.setitem(__import__("sys").modules, "pydicom", None)
    with pytest.raises(MissingPackageError, match=r"tissuereg\[dicom\]"):
        read_image(tmp_path / "seg.dcm")


def test_a_series_gives_its_grid_to_a_warped_volume(tmp_path):
    from tissuereg.imaging.transforms import grid_of

    folder = write_slices(tmp_path / "ct")
    assert grid_of(None, folder, None, back=False).steps == pytest.approx(GRID.steps, abs=1e-5)
    write_image(tmp_path / "ct.nrrd", read_image(folder))
    assert Grid.of(read_image(tmp_path / "ct.nrrd")).origin == pytest.approx(GRID.origin, abs=1e-5)
