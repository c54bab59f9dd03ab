"""Segmentations become bodies: no steps, the right volume, on any grid; islands and cavities are told."""

import json

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.cli import main
from tissuereg.errors import FormatError, MeshingError
from tissuereg.imaging.images import Grid, write_image
from tissuereg.meshing import fill
from tissuereg.meshing.segmentation import Segmentation

needs_mesher = pytest.mark.skipif(
    fill.importlib.util.find_spec("pytetwild") is None, reason="the extra `mesh` is not installed"
)
pytest.importorskip("pyvista")

#: Half axes of the organ and radius of the tumour in it, mm, and where they are.
AXES, RADIUS, MIDDLE, OFF = np.array([35.0, 28.0, 22.0]), 9.0, np.array([10.0, -20.0, 30.0]), np.array([10.0, 5.0, 0.0])

TURN = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 0.8, 0.2], [0.1, -0.3, 1.0]]))[0]


def segmented(path, *, turn=TURN, spacing=(1.0, 1.0, 2.5), size=(90, 90, 40), spoilt=True):
    """Write an ellipsoid with a ball in it, with an island and a cavity of one voxel each."""
    steps = turn * np.array(spacing)
    grid = Grid(size, MIDDLE - steps @ (0.5 * (np.array(size) - 1)), steps)
    numbers = np.stack(np.meshgrid(*[np.arange(n) for n in size[::-1]], indexing="ij"), axis=-1)
    off = grid.places(numbers[..., ::-1].reshape(-1, 3).astype(float)) - MIDDLE
    organ, tumour = np.linalg.norm(off / AXES, axis=1) < 1.0, np.linalg.norm(off - OFF, axis=1) < RADIUS
    values = np.where(tumour, 5, np.where(organ, 1, 0)).astype(np.uint8).reshape(size[::-1])
    if spoilt:
        values[2, 2, 2], values[size[2] // 2 - 3, 45, 45] = 1, 0
    image = grid.image(values)
    for number, (name, value) in enumerate({"organ": 1, "tumour": 5}.items()):
        image.SetMetaData(f"Segment{number}_Name", name)
        image.SetMetaData(f"Segment{number}_LabelValue", str(value))
    return write_image(path, image)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_surface_is_that_of_the_organ_without_steps(tmp_path, mirrored):
    turn = TURN * (np.array([1.0, -1.0, 1.0]) if mirrored else 1.0)
    path = segmented(tmp_path / "s.seg.nrrd", turn=turn)
    surface, said = Segmentation.read(path, ["organ", "tumour"]).surface()
    assert surface.frame == "LPS"
    share = np.linalg.norm((surface.vertices - MIDDLE) / AXES, axis=1)
    # A step of a voxel would be 2.5 of 22 mm.
    assert share.min() > 0.95
    assert share.max() < 1.03
    assert share.std() < 0.012
    assert surface.volume == pytest.approx(4.0 / 3.0 * np.pi * AXES.prod(), rel=0.01)
    assert [words.split()[1] for words in said] == ["islands,", "cavities,"]
    assert Segmentation.read(path, [1, 5]).surface()[0].volume == pytest.approx(surface.volume)


def test_a_label_at_the_border_of_the_image_is_told(tmp_path):
    path = segmented(tmp_path / "s.nrrd", size=(60, 90, 40), spoilt=False)
    assert any("border of the image" in words for words in Segmentation.read(path, [1, 5]).surface()[1])


def test_several_parts_are_told_and_an_empty_one_refused(tmp_path):
    values = np.zeros((20, 20, 20), np.uint8)
    values[3:8, 3:8, 3:8] = values[12:17, 12:17, 12:17] = 2
    values[10, 10, 10] = 3
    path = write_image(tmp_path / "two.nii.gz", Grid((20,) * 3, np.zeros(3), np.eye(3)).image(values))
    assert "the label has 2 parts" in Segmentation.read(path, ["2"]).surface()[1]
    with pytest.raises(MeshingError, match="larger than a voxel"):
        Segmentation.read(path, [3]).surface()


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.8, 0.8, 2.0)])
@pytest.mark.parametrize("radius", [3.0, 6.0, 14.0])
def test_a_small_label_keeps_its_volume(tmp_path, radius, spacing):
    size = (40, 40, 24)
    grid = Grid(size, np.zeros(3), np.diag(spacing))
    numbers = np.stack(np.meshgrid(*[np.arange(n) for n in size[::-1]], indexing="ij"), axis=-1)[..., ::-1]
    middle = 0.5 * np.array(spacing) * size + 0.2
    inside = np.linalg.norm(numbers * spacing - middle, axis=-1) < min(radius, 0.3 * middle[2] * 2.0)
    path = write_image(tmp_path / "ball.nrrd", grid.image(inside.astype(np.uint8)))
    surface, said = Segmentation.read(path, [1]).surface(threads=1)
    assert surface.volume == pytest.approx(inside.sum() * np.prod(spacing), rel=0.005)
    assert said == []
    off = np.linalg.norm(surface.vertices - middle, axis=1)
    assert off.std() < 0.25 * max(spacing)


def test_a_plate_of_two_voxels_keeps_its_thickness(tmp_path):
    inside = np.zeros((12, 44, 44), np.uint8)
    inside[5:7, 6:38, 6:38] = 1
    path = write_image(tmp_path / "plate.nrrd", Grid((44, 44, 12), np.zeros(3), np.eye(3)).image(inside))
    surface, _ = Segmentation.read(path, [1]).surface()
    middle = np.all(np.abs(surface.vertices[:, :2] - 21.5) < 8.0, axis=1)
    assert np.ptp(surface.vertices[middle, 2]) == pytest.approx(2.0, abs=0.15)
    assert surface.volume == pytest.approx(inside.sum(), rel=0.005)


def test_a_segment_whose_name_is_the_number_of_another_is_refused(tmp_path):
    values = np.zeros((12, 12, 12), np.uint8)
    values[3:9, 3:9, 3:6], values[3:9, 3:9, 6:9] = 2, 5
    image = Grid((12,) * 3, np.zeros(3), np.eye(3)).image(values)
    for number, (name, value) in enumerate((("2", "5"), ("cyst", "2"))):
        image.SetMetaData(f"Segment{number}_Name", name)
        image.SetMetaData(f"Segment{number}_LabelValue", value)
    path = write_image(tmp_path / "s.seg.nrrd", image)
    assert Segmentation.read(path, [2]).labels == {"2": 2}
    assert Segmentation.read(path, ["cyst", "5"]).labels == {"cyst": 2, "5": 5}
    with pytest.raises(MeshingError, match="name of label 5 and the number of another"):
        Segmentation.read(path, ["2"])
    image.SetMetaData("Segment1_LabelValue", "2.5")
    path = write_image(tmp_path / "t.seg.nrrd", image)
    with pytest.raises(MeshingError, match="Segment1_LabelValue must be a whole number"):
        Segmentation.read(path, ["cyst"])


def test_segments_that_share_a_name_are_asked_for_by_number(tmp_path):
    values = np.zeros((12, 12, 12), np.uint8)
    values[3:9, 3:9, 3:6], values[3:9, 3:9, 6:9], values[0, 0, 0] = 1, 2, 3
    image = Grid((12,) * 3, np.zeros(3), np.eye(3)).image(values)
    for number, name in enumerate(("lesion", "lesion", "vessel")):
        image.SetMetaData(f"Segment{number}_Name", name)
    path = write_image(tmp_path / "s.seg.nrrd", image)
    assert Segmentation.read(path, [2, "vessel"]).labels == {"2": 2, "vessel": 3}
    with pytest.raises(MeshingError, match=r"vessel \(3\), 1, 2; got 'lesion'"):
        Segmentation.read(path, ["lesion"])


@needs_mesher
def test_a_body_with_labels_by_the_command(tmp_path, capsys):
    path = segmented(tmp_path / "s.seg.nrrd")
    words = [
        "mesh",
        str(path),
        "--label",
        "organ",
        "--label",
        "tumour",
        "--size",
        "7",
        "--fixed",
        "label tumour 12",
        "--set",
        "far",
        "label tumour 40",
        "--out",
        str(tmp_path / "b.vtu"),
    ]
    assert main([*words, "--json", str(tmp_path / "told.json")]) == 0
    told = json.loads((tmp_path / "told.json").read_text(encoding="utf-8"))
    assert told["frame"] == "LPS"
    volumes = {name: one["volume_mm3"] for name, one in told["labels"].items()}
    assert sum(volumes.values()) == pytest.approx(told["volume_mm3"], rel=0.01)
    assert volumes["tumour"] == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.05)
    assert "island" in told["repaired"][0]
    mesh = tr.read_mesh(tmp_path / "b.vtu")
    assert mesh.frame == "LPS"
    assert np.linalg.norm((mesh.nodes - MIDDLE) / AXES, axis=1).max() < 1.05
    voxels = {name: one["voxels_mm3"] for name, one in told["labels"].items()}
    assert voxels["tumour"] == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.02)
    change = 100.0 * (volumes["tumour"] / voxels["tumour"] - 1.0)
    assert f" mm^3, {change:+.2g} % against its voxels ({voxels['tumour']:.6g} mm^3)" in capsys.readouterr().out
    # The tumour's surface is made of faces: no tet has corners on both sides of it.
    above = np.linalg.norm(mesh.nodes - MIDDLE - OFF, axis=1) - RADIUS
    corners = above[mesh.tets]
    assert not ((corners.min(axis=1) < -1.5) & (corners.max(axis=1) > 1.5)).any()
    inside = np.isin(mesh.tets, mesh.node_set("tumour")).all(axis=1)
    # Flat tets beside it have all corners in the set, too: how many, differs from run to run of the mesher.
    within = np.linalg.norm(mesh.nodes[mesh.tets].mean(axis=1) - MIDDLE - OFF, axis=1) < RADIUS
    assert inside[within].all()
    assert mesh.volumes[within].sum() == pytest.approx(volumes["tumour"], rel=0.03)
    assert np.array_equal(np.union1d(mesh.node_set("organ"), mesh.node_set("tumour")), np.arange(mesh.n_nodes))
    # Nodes of the surface near the label, to the middles of its voxels.
    skin = mesh.surface_nodes
    assert np.isin(skin[above[skin] < 10.5], mesh.fixed_nodes).all()
    assert np.isin(mesh.fixed_nodes, skin[above[skin] < 13.5]).all()
    assert len(mesh.node_set("far")) > len(mesh.fixed_nodes)


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ("label cyst 3", r"labels in .*organ \(1\), tumour \(5\); got 'cyst'"),
        ("label tumour -3", "'label NAME r', a label of"),
        ("label tumour far", "'label NAME r', a label of"),
        ("label tumour", "'label NAME r', a label of"),
    ],
)
def test_a_label_or_a_distance_that_is_none_is_refused_before_the_mesher(tmp_path, rule, said):
    path = segmented(tmp_path / "s.seg.nrrd", size=(45, 45, 20), spacing=(2.0, 2.0, 5.0), spoilt=False)
    with pytest.raises(MeshingError, match=said):
        tr.tetrahedralize((path, ["organ"]), 6.0, fixed=rule)


@needs_mesher
def test_a_label_far_away_holds_nothing_and_one_label_has_no_set(tmp_path):
    path = segmented(tmp_path / "s.seg.nrrd", size=(45, 45, 20), spacing=(2.0, 2.0, 5.0), spoilt=False)
    with pytest.raises(MeshingError, match=r"within 0\.5 mm of label 5"):
        tr.tetrahedralize((path, ["organ", 5]), 12.0, fixed="label tumour 0.5")
    assert list(tr.tetrahedralize((path, ["organ"]), 12.0).node_sets) == []


@pytest.mark.parametrize(
    ("error", "said", "options"),
    [
        (MeshingError, r"organ \(1\), tumour \(5\)", {"labels": ["liver"]}),
        (MeshingError, "must name at least one", {"labels": []}),
        (MeshingError, "must be a list", {"labels": 3.5}),
        (MeshingError, "must be a list", {"labels": 1}),
        (MeshingError, "names or whole numbers", {"labels": [1.0]}),
        (MeshingError, "names or whole numbers", {"labels": [True]}),
        (FormatError, "LPS", {"labels": ["organ"], "frame": "RAS"}),
        (FormatError, "mm", {"labels": ["organ"], "unit": "cm"}),
    ],
)
def test_labels_that_are_not_there_and_other_frames_are_refused(tmp_path, error, said, options):
    options = dict(options)
    path = segmented(tmp_path / "s.seg.nrrd", size=(45, 45, 20), spacing=(2.0, 2.0, 5.0), spoilt=False)
    with pytest.raises(error, match=said):
        tr.tetrahedralize((path, options.pop("labels")), 6.0, **options)


def test_what_is_no_label_map_is_refused(tmp_path):
    grid = Grid((8, 8, 8), np.zeros(3), np.eye(3))
    write_image(tmp_path / "ct.nrrd", grid.image(np.full((8, 8, 8), 0.5, np.float32)))
    write_image(tmp_path / "two.nrrd", grid.image(np.ones((8, 8, 8, 2), np.uint8)))
    with pytest.raises(MeshingError, match="whole numbers"):
        tr.tetrahedralize((tmp_path / "ct.nrrd", [1]), 3.0)
    with pytest.raises(MeshingError, match="one label a voxel"):
        tr.tetrahedralize((tmp_path / "two.nrrd", [1]), 3.0)
    with pytest.raises(MeshingError, match=r"at least one of the labels in .*: 1; got none"):
        tr.tetrahedralize(write_image(tmp_path / "s.nrrd", grid.image(np.ones((8, 8, 8), np.uint8))), 3.0)
    spoilt = np.full((8, 8, 8), np.nan)
    for values in (spoilt, spoilt + np.inf, np.full((8, 8, 8), 2**62, np.int64)):
        with pytest.raises(MeshingError, match=r"whole numbers below 2\^53"):
            tr.tetrahedralize((write_image(tmp_path / "large.nrrd", grid.image(values)), [1]), 3.0)
    write_image(tmp_path / "wave.nrrd", grid.image(np.ones((8, 8, 8), np.complex64)))
    with pytest.raises(FormatError, match="real numbers, got complex"):
        tr.tetrahedralize((tmp_path / "wave.nrrd", [1]), 3.0)
    with pytest.raises(FormatError, match="must be an image"):
        tr.tetrahedralize(("body.stl", [1]), 3.0)
