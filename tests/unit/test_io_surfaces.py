"""Surfaces from files of every kind, in any unit, or refused with the unit that would do."""

import itertools

import numpy as np
import pytest

from support.grids import write_grid
from support.surfaces import box, sphere, volume, write_stl
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, ShapeError, UnitError, UnitWarning
from tissuereg.io.surfaces import read_triangles

BALL = sphere()


def written(path, surface=BALL, scale=1.0):
    """Write a surface by whatever writes that kind of file."""
    import trimesh

    vertices, triangles = surface[0] * scale, surface[1]
    if path.suffix == ".vtp":
        pyvista = pytest.importorskip("pyvista", reason="the extra `mesh` is not installed")
        pyvista.PolyData.from_regular_faces(vertices, triangles).save(str(path))
    elif path.suffix in (".vtu", ".vtk", ".msh"):
        write_grid(path, vertices, [("triangle", triangles)])
    else:
        trimesh.Trimesh(vertices, triangles, process=False).export(str(path))
    return path


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "off", "vtp", "vtu", "vtk", "msh"])
@pytest.mark.filterwarnings("ignore")  # those of the writers
def test_every_kind_of_file_gives_the_same_surface(tmp_path, suffix, capsys):
    found = read_triangles(written(tmp_path / f"ball.{suffix}"))
    assert len(found.vertices) == len(BALL[0])
    assert len(found.triangles) == len(BALL[1])
    # Single precision, or eight digits in text.
    assert found.volume == pytest.approx(volume(BALL), rel=1e-6)
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "")


def test_four_cornered_faces_are_cut_in_two(tmp_path):
    corners = np.array(list(itertools.product((0, 30), repeat=3)), float)
    sides = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]]
    write_grid(tmp_path / "box.vtu", corners, [("quad", sides)])
    found = read_triangles(tmp_path / "box.vtu")
    assert len(found.triangles) == 12
    assert found.volume == pytest.approx(27000.0)


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1.0), ("cm", 0.1), ("m", 0.001)])
def test_the_unit_is_told_and_the_answer_is_in_mm(tmp_path, unit, scale):
    file = write_stl(tmp_path / "ball.stl", BALL, scale=scale)
    assert read_triangles(file, unit).extent == pytest.approx(40.0, rel=1e-6)
    assert read_triangles((BALL[0] * scale, BALL[1]), unit).extent == pytest.approx(40.0, rel=1e-12)
    assert read_triangles(Triangles(BALL[0] * scale, BALL[1]), unit).extent == pytest.approx(40.0, rel=1e-12)


@pytest.mark.parametrize(
    ("scale", "unit", "words"),
    [
        (0.003, None, r"^extent 0\.12: looks like metres; say --unit m \("),
        (0.1, None, r"^extent 4: looks like centimetres; say --unit cm \("),
        (1.0, "m", r"^extent 40: looks like millimetres; say --unit mm \(.*read in m, has 4e\+04 mm"),
        (1e-7, None, "neither of mm, cm, m makes this a body"),
        (1e4, "mm", "neither of mm, cm, m makes this a body"),
    ],
)
def test_an_extent_that_no_organ_has_is_refused_with_the_likely_unit(tmp_path, scale, unit, words):
    file = write_stl(tmp_path / "ball.stl", BALL, scale=scale)
    with pytest.raises(UnitError, match=words) as caught:
        read_triangles(file, unit)
    assert caught.value.where == str(file)


@pytest.mark.parametrize("extent", [5.0, 2000.0])
def test_the_extents_that_organs_may_have_end_at_5_and_2000_mm(extent):
    vertices = BALL[0] * extent / np.ptp(BALL[0], axis=0).max()
    with pytest.warns(UnitWarning, match="A body is rarely smaller than 20 or larger than 600 mm"):
        assert read_triangles((vertices, BALL[1])).extent == pytest.approx(extent)
    assert read_triangles((vertices, BALL[1]), "mm").extent == pytest.approx(extent)  # who says so is believed
    for outside in (0.999, 1.001):
        beyond = vertices * (outside if (extent == 5.0) == (outside < 1) else 1 / outside)
        with pytest.raises(UnitError):
            read_triangles((beyond, BALL[1]))


@pytest.mark.parametrize("note", [b"UNITS=m", b"liver, unit: meters", b"exported, Units = m"])
def test_an_stl_that_says_its_unit_is_believed(tmp_path, note):
    file = write_stl(tmp_path / "ball.stl", BALL, head=note, scale=0.001)
    assert read_triangles(file).extent == pytest.approx(40.0, rel=1e-6)


def test_comments_of_a_ply_and_an_obj_may_say_the_unit(tmp_path):
    ply = written(tmp_path / "ball.ply", scale=0.1)
    head, _, rest = ply.read_bytes().partition(b"\n")
    first, _, rest = rest.partition(b"\n")
    ply.write_bytes(head + b"\n" + first + b"\ncomment unit: cm\n" + rest)
    assert read_triangles(ply).extent == pytest.approx(40.0, rel=1e-6)
    obj = written(tmp_path / "ball.obj", scale=0.001)
    obj.write_text("# units: metres\n" + obj.read_text())
    assert read_triangles(obj).extent == pytest.approx(40.0, rel=1e-4)


def test_what_the_user_says_outweighs_the_file_and_the_contradiction_is_told(tmp_path):
    file = write_stl(tmp_path / "ball.stl", BALL, head=b"UNITS=m")
    with pytest.warns(UserWarning, match=r"states that it is in metres; it is read in millimetres, as given"):
        assert read_triangles(file, "mm").extent == pytest.approx(40.0, rel=1e-6)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "off", "vtu", "vtk"])
def test_a_spoilt_file_is_a_format_error_and_prints_nothing(tmp_path, capsys, suffix):
    (tmp_path / f"b.{suffix}").write_bytes(b"\x00\x01 no surface at all\n" * 9)
    with pytest.raises(FormatError, match=rf"b\.{suffix}"):
        read_triangles(tmp_path / f"b.{suffix}")
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "")


def test_other_inputs_are_named_for_what_they_are(tmp_path, block_mesh):
    with pytest.raises(FormatError, match=r"no such file"):
        read_triangles(tmp_path / "gone.stl")
    (tmp_path / "b.txt").write_text("1 2 3\n")
    with pytest.raises(FormatError, match=r"must be one of \.stl, .*got 'b\.txt'"):
        read_triangles(tmp_path / "b.txt")
    write_grid(tmp_path / "b.vtu", block_mesh.nodes, [("tetra", block_mesh.tets)])
    with pytest.raises(FormatError, match="surface of triangles or quads; it holds cells of kind tetra"):
        read_triangles(tmp_path / "b.vtu")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\n")
    with pytest.raises(FormatError, match=r"points\.obj"):
        read_triangles(tmp_path / "points.obj")
    with pytest.raises(FormatError, match="one of mm, cm, m, got 'inch'"):
        read_triangles(box(), "inch")
    with pytest.raises(ShapeError, match="got 3 things"):
        read_triangles((1, 2, 3))
