"""Grid transforms and warped images: as SimpleITK reads them, on oblique grids, in both patient frames."""

import gzip
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 (its own habit)

import tissuereg as tr
from support.meshes import block
from tissuereg._core import rasterise
from tissuereg.errors import ArgumentError, FormatError, MissingPackageError
from tissuereg.imaging import images, warp
from tissuereg.imaging.images import Grid, read_image, write_image
from tissuereg.imaging.sampled import Mark, Sampled
from tissuereg.imaging.warp import _Labels, _resampled, warp_image, warp_points, warp_surface
from tissuereg.io.atomic import OutputError
from tissuereg.io.points import turned
from tissuereg.io.surfaces import read_triangles
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.field import RegisteredField

#: Columns of an oblique, anisotropic image.
TURN = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 0.8, 0.2], [0.1, -0.3, 1.0]]))[0]


def bent(places):
    x, y, z = np.moveaxis(places, -1, 0)
    return np.stack([0.0016 * z**2, 0.05 * z * np.sin(x / 15.0), -0.03 * z + 0.01 * y], axis=-1)


@lru_cache
def field(frame=None):
    mesh = block((40.0, 30.0, 50.0), (6, 5, 8)).in_frame(frame)
    roots = np.random.default_rng(0).standard_normal((5, mesh.n_nodes, 3))
    return RegisteredField(mesh, bent(mesh.nodes), Deviations.of(roots, np.zeros(mesh.n_nodes), None, 0.0))


def oblique(frame=None, spacing=(1.5, 1.0, 2.0), size=(60, 70, 50)) -> Grid:
    """A grid over the whole body, in LPS."""
    steps = TURN * np.array(spacing)
    middle = turned(np.array([20.0, 15.0, 25.0]), frame, "LPS")
    return Grid(size, middle - steps @ (0.5 * (np.array(size) - 1)), steps)


def inner(count=400, seed=1, frame=None):
    rng = np.random.default_rng(seed)
    return rng.uniform([2.0, 2.0, 2.0], [38.0, 28.0, 48.0], (count, 3))


def saved(grid: Grid, values, path: Path) -> Path:
    return write_image(path, grid.image(values))


@pytest.mark.parametrize("frame", [None, "LPS", "RAS"])
def test_a_grid_in_nrrd_moves_points_as_the_field_does(tmp_path, frame):
    like = saved(oblique(frame), np.zeros(oblique().size[::-1], np.uint8), tmp_path / "ct.nrrd")
    made = field(frame).transform(tmp_path / "field.nrrd", like=like, std=tmp_path / "sigma.nrrd")
    image = sitk.ReadImage(str(tmp_path / "field.nrrd"))
    assert image.GetMetaData("displacement field type") == "modeling"
    assert image.GetMetaData("intent_code") == "1006"
    header = (tmp_path / "field.nrrd").read_bytes().split(b"\n\n")[0].decode()
    assert "kinds: vector domain domain domain" in header
    assert "space: left-posterior-superior" in header
    there = sitk.DisplacementFieldTransform(sitk.Cast(image, sitk.sitkVectorFloat64))
    places = inner()
    found = np.array([there.TransformPoint(p) for p in turned(places, frame, "LPS")])
    # What a grid of 1 to 2 mm makes of kinks between elements of 6 mm.
    off = np.linalg.norm(found - turned(field().at(places).mean, frame, "LPS"), axis=1)
    assert off.mean() < 0.02
    assert off.max() < 0.15
    assert made.residual_mm is None
    assert made.moved_mm[1] == pytest.approx(np.linalg.norm(bent(field().mesh.nodes), axis=1).max(), rel=0.05)
    sigma = sitk.ReadImage(str(tmp_path / "sigma.nrrd"))
    array = sitk.GetArrayFromImage(sigma)
    inside = np.isfinite(array)
    assert inside.mean() == pytest.approx(60e3 / (np.prod(oblique().size) * 3.0), rel=0.03)
    assert array[inside].min() >= field().uncertainty.std.min() - 1e-4
    assert array[inside].max() <= field().uncertainty.std.max() + 1e-4


@pytest.mark.parametrize("spacing", [1e-300, 5e-324, 0.01])
def test_a_grid_beyond_the_largest_is_refused_before_it_is_made(tmp_path, spacing):
    with pytest.raises(ArgumentError, match="at most 270000000 voxels over"):
        field().transform(tmp_path / "field.nrrd", spacing=spacing)


def test_no_transform_is_written_without_its_spread(tmp_path):
    (tmp_path / "sigma.nrrd").mkdir()
    with pytest.raises(OutputError):
        field().transform(tmp_path / "field.nrrd", spacing=4.0, std=tmp_path / "sigma.nrrd")
    assert not (tmp_path / "field.nrrd").exists()


@pytest.mark.parametrize("ending", [".h5", ".tfm"])
def test_itk_s_transform_leads_back(tmp_path, ending):
    made = field().transform(tmp_path / f"back{ending}", spacing=1.0)
    assert made.residual_mm < 1e-5
    back = sitk.ReadTransform(str(tmp_path / f"back{ending}"))
    places = inner()
    found = np.array([back.TransformPoint(p) for p in field().at(places).mean])
    off = np.linalg.norm(found - places, axis=1)
    assert off.mean() < 0.02
    assert off.max() < 0.15


def test_voxels_are_where_the_field_says_and_forward_undoes_back():
    grid = oblique()
    for back in (False, True):
        sampled = Sampled(field().space, grid, back, threads=1)
        moved, by = sampled.slices(20, 3)
        numbers = np.argwhere(by > Mark.BEYOND)[::37]
        places = grid.places(numbers[:, ::-1] + [0.0, 0.0, 20.0])
        wanted = field().space.back(places) if back else field().space.at(places)[0]
        found = moved[tuple(numbers.T)]
        assert np.abs(found - (-wanted if back else wanted)).max() < 1e-4
        if not back:
            assert np.array_equal(by[tuple(numbers.T)] == Mark.INSIDE, field().space.at(places)[1])
    assert Sampled(field().space, grid, back=True).residual_mm() < 1e-5
    assert {Mark.AROUND, Mark.INSIDE} <= set(np.unique(by))


def test_rasterised_slices_do_not_depend_on_how_they_are_cut_or_on_threads():
    grid = oblique()
    one, two = (Sampled(field().space, grid, back=True, threads=n) for n in (1, 2))
    whole, marks = one.slices(10, 6)
    assert np.array_equal(two.slices(10, 6)[0], whole)
    assert np.array_equal(one.slices(13, 1)[0][0], whole[3])
    assert np.array_equal(one.slices(13, 1)[1][0], marks[3])
    with pytest.raises(tr.errors.ShapeError, match="values"):
        rasterise(np.zeros((4, 3)), np.array([[0, 1, 2, 3]]), np.zeros((3, 3)), 0, (0, 1, 1, 1), 1)
    with pytest.raises(tr.errors.MeshError):
        rasterise(np.zeros((4, 3)), np.array([[0, 1, 2, 4]]), np.zeros((4, 3)), 0, (0, 1, 1, 1), 1)


def ball(places):
    return np.linalg.norm(places - [20.0, 15.0, 30.0], axis=-1) < 13.0


@pytest.mark.parametrize("frame", [None, "RAS"])
def test_a_label_map_moves_as_the_surface_does_and_labels_are_not_mixed(tmp_path, frame):
    grid = oblique(frame, (1.0, 1.0, 1.0), (60, 55, 65))
    every = np.stack(np.meshgrid(*[np.arange(n) for n in grid.size[::-1]], indexing="ij"), axis=-1)
    places = turned(grid.places(every[..., ::-1].reshape(-1, 3).astype(float)), "LPS", frame)
    labels = np.where(ball(places), 7, np.where(places[:, 2] < 15.0, 200, 0)).astype(np.uint8).reshape(grid.size[::-1])
    image = grid.image(labels)
    image.SetMetaData("Segment0_Name", "tumour")
    write_image(tmp_path / "seg.seg.nrrd", image)
    made = warp_image(field(frame), tmp_path / "seg.seg.nrrd", tmp_path / "moved.seg.nrrd", labels=True)
    moved = sitk.ReadImage(str(tmp_path / "moved.seg.nrrd"))
    found = sitk.GetArrayFromImage(moved)
    assert found.dtype == np.uint8
    assert set(np.unique(found)) == {0, 7, 200}
    assert moved.GetMetaData("Segment0_Name") == "tumour"
    wanted = np.zeros(len(places), dtype=bool)
    near = np.flatnonzero(np.linalg.norm(places - [22.0, 16.0, 28.0], axis=1) < 22.0)
    wanted[near] = ball(places[near] - field(frame).space.back(places[near]))
    wanted = wanted.reshape(found.shape)
    both = np.count_nonzero((found == 7) & wanted)
    assert 2.0 * both / (np.count_nonzero(found == 7) + np.count_nonzero(wanted)) >= 0.98
    # It has moved: as it was, the two would agree less.
    assert 2.0 * np.count_nonzero((labels == 7) & wanted) / (np.count_nonzero(labels == 7) + wanted.sum()) < 0.9
    assert made.residual_mm < 1e-5


def test_labels_are_those_of_the_largest_linear_weight_as_itk_finds_them():
    rng, grid = np.random.default_rng(2), oblique(spacing=(2.0, 2.0, 2.0), size=(20, 22, 24))
    values = rng.integers(0, 4, grid.size[::-1]).astype(np.uint8)
    values[:, :, 12:] = 3
    source, moved = grid.image(values), (0.8 * rng.standard_normal((24, 22, 20, 3))).astype(np.float32)
    found = _Labels.of(source).at(grid, moved, 0)
    wanted = _resampled(source, grid, moved, 0, (sitk.sitkLabelLinear, 0.0, 1))
    inner = (slice(2, -2),) * 3
    # Equal weights of two labels are rare.
    assert np.mean(found[inner] == wanted[inner]) > 0.998
    assert np.array_equal(_Labels.of(sitk.Cast(source, sitk.sitkFloat32)).at(grid, moved, 0), found)
    for wrong in (values + 0.5, np.full(values.shape, np.nan), np.full(values.shape, 2**62, np.int64)):
        with pytest.raises(ArgumentError, match="whole numbers"):
            _Labels.of(grid.image(wrong))


def test_a_volume_takes_its_values_from_where_voxels_were(tmp_path):
    grid = oblique(spacing=(1.0, 1.2, 0.9), size=(70, 60, 80))
    every = np.stack(np.meshgrid(*[np.arange(n) for n in grid.size[::-1]], indexing="ij"), axis=-1)
    places = grid.places(every[..., ::-1].reshape(-1, 3).astype(float))
    ramp = (3.0 * places[:, 0] - 2.0 * places[:, 1] + places[:, 2]).reshape(grid.size[::-1]).astype(np.float32)
    saved(grid, ramp, tmp_path / "ct.mha")
    # On another grid, of another kind of file.
    other = saved(oblique(), np.zeros(oblique().size[::-1], np.int16), tmp_path / "like.nii.gz")
    warp_image(field(), tmp_path / "ct.mha", tmp_path / "moved.nii.gz", labels=False, like=other)
    moved = sitk.ReadImage(str(tmp_path / "moved.nii.gz"))
    assert moved.GetSize() == oblique().size
    at = inner(200)
    found = sitk.GetArrayFromImage(moved)
    numbers = np.rint(Grid.of(moved).indices(field().at(at).mean)).astype(int)
    voxels = Grid.of(moved).places(numbers.astype(float))
    inside = field().at(voxels - field().space.back(voxels)).inside
    came = voxels - field().space.back(voxels)
    wanted = 3.0 * came[:, 0] - 2.0 * came[:, 1] + came[:, 2]
    assert np.abs(found[tuple(numbers[:, ::-1].T)] - wanted)[inside].max() < 0.02
    assert found.min() == pytest.approx(ramp.min(), abs=0.1)


def test_a_volume_may_lack_values_but_not_all(tmp_path):
    grid = oblique(spacing=(3.0, 3.0, 3.0), size=(40, 40, 40))
    values = np.full(grid.size[::-1], 5.0, np.float32)
    values[:, :, 20:], values[0] = 2.0, np.nan
    warp_image(field(), saved(grid, values, tmp_path / "a.nrrd"), tmp_path / "moved.nrrd", labels=False)
    found = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "moved.nrrd")))
    assert np.nanmin(found) == 2.0
    saved(grid, np.full_like(values, np.nan), tmp_path / "b.nrrd")
    with pytest.raises(ArgumentError, match="finite value"):
        warp_image(field(), tmp_path / "b.nrrd", tmp_path / "other.nrrd", labels=False)


def test_filters_run_in_as_many_threads_as_are_asked_for(tmp_path, monkeypatch):
    made = images.threaded("ResampleImageFilter", 3)
    assert made.GetNumberOfThreads() == 3
    assert (
        images.threaded("ResampleImageFilter", 0).GetNumberOfThreads()
        == sitk.ResampleImageFilter().GetNumberOfThreads()
    )
    asked = []
    monkeypatch.setattr(warp, "threaded", lambda kind, threads: asked.append(threads) or images.threaded(kind, threads))
    grid = oblique(spacing=(4.0, 4.0, 4.0), size=(30, 30, 30))
    ones = saved(grid, np.ones(grid.size[::-1], np.uint8), tmp_path / "a.nrrd")
    for labels in (True, False):
        warp_image(field(), ones, tmp_path / "moved.nrrd", labels=labels, threads=2)
    assert set(asked) == {2}


def test_a_surface_keeps_its_triangles_and_its_vertices_move(tmp_path):
    vertices, triangles = field().mesh.nodes, field().mesh.surface
    used, corners = np.unique(triangles, return_inverse=True)
    surface = tr.Triangles(vertices[used], corners.reshape(-1, 3), "LPS")
    for ending in (".ply", ".obj", ".stl"):
        made = warp_surface(field("LPS"), surface, tmp_path / f"moved{ending}")
        back = read_triangles(tmp_path / f"moved{ending}")
        assert back.frame == "LPS"
        wanted = vertices + bent(vertices)
        if ending != ".stl":
            assert back.vertices == pytest.approx(wanted[used], abs=1e-6)
            assert np.array_equal(back.triangles, surface.triangles)
        else:
            assert back.vertices[back.triangles] == pytest.approx(wanted[triangles], abs=1e-4)
        assert back.volume == pytest.approx(tr.Triangles(wanted, triangles).volume, rel=1e-5)
        assert made.outside == 0
    with pytest.raises(FormatError, match=r"\.stl, \.ply, \.obj"):
        warp_surface(field(), surface, tmp_path / "moved.vtp")
    with pytest.raises(FormatError, match="LPS"):
        warp_surface(field("RAS"), surface, tmp_path / "other.ply")


def test_points_are_written_with_their_spread_and_flags(tmp_path):
    made = warp_points(
        field("RAS"), {"a": np.array([20.0, 15.0, 30.0]), "b": np.array([20.0, 15.0, 70.0])}, tmp_path / "p.csv"
    )
    lines = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "point,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm,std_mm,flag"
    assert lines[2].endswith("outside the body")
    assert float(lines[1].split(",")[4]) == pytest.approx(field().at([[20.0, 15.0, 30.0]]).mean[0, 0], abs=1e-6)
    assert made.outside == 1
    warp_points(field("RAS"), {"a": np.array([20.0, 15.0, 30.0])}, tmp_path / "p.mrk.json")
    assert tr.read_targets(tmp_path / "p.mrk.json", frame="RAS")["a"] == pytest.approx(
        field().at([[20.0, 15.0, 30.0]]).mean[0], abs=1e-4
    )
    with pytest.raises(ArgumentError):
        warp_points(field(), {}, tmp_path / "none.csv")


def test_what_cannot_be_done_is_said_and_nothing_is_written(tmp_path):
    far = Grid((4, 4, 4), np.array([500.0, 0.0, 0.0]), np.eye(3))
    saved(far, np.zeros((4, 4, 4), np.uint8), tmp_path / "far.nrrd")
    (tmp_path / "text.nrrd").write_text("no image", encoding="utf-8")
    flat = sitk.Image([4, 4], sitk.sitkUInt8)
    sitk.WriteImage(flat, str(tmp_path / "flat.nrrd"))
    out = tmp_path / "out.nrrd"
    cases = [
        (ArgumentError, "like", {"like": None}),
        (ArgumentError, "like", {"like": tmp_path / "far.nrrd", "spacing": 2.0}),
        (ArgumentError, "frames", {"like": tmp_path / "far.nrrd"}),
        (ArgumentError, "above 0", {"spacing": 0.0}),
        (ArgumentError, "voxels", {"spacing": 0.01}),
        (ArgumentError, "direction", {"spacing": 2.0, "direction": "back"}),
        (FormatError, "text.nrrd", {"like": tmp_path / "text.nrrd"}),
        (FormatError, "three dimensions", {"like": tmp_path / "flat.nrrd"}),
        (FormatError, "missing", {"like": tmp_path / "missing.nrrd"}),
        (FormatError, "std", {"spacing": 2.0, "std": tmp_path / "s.nii"}),
    ]
    for error, words, options in cases:
        with pytest.raises(error, match=words):
            field().transform(out, **options)
    with pytest.raises(FormatError, match=r"nrrd, \.h5 or \.tfm"):
        field().transform(tmp_path / "field.xyz", spacing=2.0)
    with pytest.raises(ArgumentError, match="lead back"):
        field().transform(tmp_path / "field.h5", spacing=2.0, direction="modeling")
    with pytest.raises(ArgumentError, match="frames"):
        warp_image(field(), tmp_path / "far.nrrd", out, labels=True)
    with pytest.raises(FormatError, match="must end in"):
        warp_image(field(), tmp_path / "far.nrrd", tmp_path / "out.png", labels=True)
    before = (tmp_path / "far.nrrd").read_bytes()
    for like in (None, tmp_path / "far.nrrd"):
        with pytest.raises(ArgumentError, match="another file than `image`"):
            warp_image(field(), tmp_path / "far.nrrd", tmp_path / "far.nrrd", labels=True, like=like)
    assert (tmp_path / "far.nrrd").read_bytes() == before
    assert not out.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"far.nrrd", "text.nrrd", "flat.nrrd"}


def test_without_simpleitk_its_install_line_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "SimpleITK", None)
    with pytest.raises(MissingPackageError, match=r"tissuereg\[images\]"):
        images.itk()
    with pytest.raises(MissingPackageError):
        field().transform(tmp_path / "field.nrrd", spacing=2.0)


def test_files_are_compressed_where_they_can_be(tmp_path):
    grid = oblique()
    path = saved(grid, np.zeros(grid.size[::-1], np.int16), tmp_path / "zero.nii.gz")
    assert path.stat().st_size < 10_000
    assert gzip.decompress(path.read_bytes())[:4]
    read = read_image(path)
    assert Grid.of(read).origin == pytest.approx(grid.origin, abs=1e-3)
    assert Grid.of(read).steps == pytest.approx(grid.steps, abs=1e-5)
