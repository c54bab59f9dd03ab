"""Transforms with time: the header that 3D Slicer documents, and the same grids as one by one."""

import gzip
import re

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 (its own habit)

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.imaging.images import Grid, write_image
from tissuereg.imaging.transforms import write_transform
from tissuereg.io.problems import write_simulations
from tissuereg.tracking.stored import StoredTrack

MESH = block((40.0, 30.0, 50.0), (3, 3, 4)).in_frame("RAS")
TIMES = [0.5, 0.75, 2.0]


def leaning(share):
    """A lean of the block along x and y, by a share."""
    return share * MESH.nodes[:, 2:] * [0.1, 0.05, -0.02]


def track() -> StoredTrack:
    return StoredTrack(MESH, np.array(TIMES), np.array([leaning(t) for t in TIMES]))


def oblique(tmp_path):
    turn = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 0.8, 0.2], [0.1, -0.3, 1.0]]))[0]
    steps = turn * [6.0, 5.0, 8.0]
    grid = Grid((14, 20, 9), np.array([-20.0, -15.0, 25.0]) - steps @ [6.5, 9.5, 4.0], steps)
    return write_image(tmp_path / "ct.nrrd", grid.image(np.zeros((9, 20, 14), np.uint8))), grid


def opened(path):
    """Return fields of a header as text, and the values (time, slices, rows, columns, 3)."""
    head, _, packed = path.read_bytes().partition(b"\n\n")
    lines = head.decode("ascii").splitlines()
    assert lines[0] == "NRRD0005"
    fields = dict(re.split(r":=|: ", line, maxsplit=1) for line in lines[1:])
    sizes = [int(n) for n in fields["sizes"].split()]
    return fields, np.frombuffer(gzip.decompress(packed), "<f4").reshape(sizes[::-1])


def test_every_moment_is_the_transform_of_its_field(tmp_path):
    like, grid = oblique(tmp_path)
    made = track().transform(tmp_path / "field.seq.nrrd", like=like, threads=1)
    fields, values = opened(tmp_path / "field.seq.nrrd")
    assert (fields["dimension"], fields["kinds"]) == ("5", "vector domain domain domain list")
    assert fields["space"] == "left-posterior-superior"
    assert fields["axis 3 index type"] == "numeric"
    assert [float(t) for t in fields["axis 3 index values"].split()] == TIMES
    assert (fields["displacement field type"], fields["intent_code"]) == ("modeling", "1006")
    vectors = [[float(x) for x in each.split(",")] for each in re.findall(r"\(([^)]*)\)", fields["space directions"])]
    assert fields["space directions"].split()[::4] == ["none", "none"]
    assert np.abs(np.array(vectors).T - grid.steps).max() < 1e-9
    assert values.shape == (3, 9, 20, 14, 3)
    for moment, field in enumerate(track().displacement):
        space = tr.registration.field.SpaceMap(MESH, field)
        write_transform(space, tmp_path / "one.nrrd", like=like, direction="modeling")
        one = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "one.nrrd")))
        assert np.array_equal(values[moment], one)
    assert made.moved_mm[1] == pytest.approx(np.linalg.norm(leaning(2.0), axis=1).max(), rel=0.1)


def test_a_reader_of_others_finds_the_same_grids(tmp_path):
    track().transform(tmp_path / "field.seq.nrrd", spacing=9.0)
    _, values = opened(tmp_path / "field.seq.nrrd")
    image = sitk.ReadImage(str(tmp_path / "field.seq.nrrd"))
    assert image.GetSize()[-1] == 3
    assert np.array_equal(sitk.GetArrayFromImage(image).reshape(values.shape), values)


def test_a_track_is_read_from_its_folder_and_nothing_else(tmp_path):
    (tmp_path / "tracked").mkdir()
    write_simulations(tmp_path / "tracked" / "fields.npz", TIMES, track().displacement, MESH)
    found = tr.tracking.read_track(tmp_path / "tracked")
    assert found.mesh.digest() == MESH.digest()
    assert np.array_equal(found.displacement, track().displacement)
    assert "3 frames from 0.5 to 2 s" in repr(found)
    write_simulations(tmp_path / "tracked" / "fields.npz", TIMES, track().displacement)
    with pytest.raises(FormatError, match="nodes_mm"):
        tr.tracking.read_track(tmp_path / "tracked")
    (tmp_path / "tracked" / "fields.npz").unlink()
    with pytest.raises(FormatError, match="track with --fields"):
        tr.tracking.read_track(tmp_path / "tracked")


@pytest.mark.parametrize(
    ("name", "options", "error", "said"),
    [
        ("field.nrrd", {"spacing": 9.0}, FormatError, r"must end in \.seq\.nrrd"),
        ("field.seq.nrrd", {"spacing": 0.18}, ArgumentError, "3 moments of .* take a coarser grid"),
        ("field.seq.nrrd", {}, ArgumentError, "one of `like` and `spacing`"),
    ],
)
def test_what_cannot_be_written_leaves_no_file(tmp_path, name, options, error, said):
    with pytest.raises(error, match=said):
        track().transform(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())
