"""What .stl, .ply, .obj and .off may hold, each read as other programs read it; the frame that a file states."""

import numpy as np
import pytest
import trimesh

from support.surfaces import box, sphere, volume, write_stl
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError
from tissuereg.io.polygons import cut
from tissuereg.io.surfaces import read_triangles

BALL = sphere(subdivisions=1)
BOX = box((20.0, 30.0, 40.0), corner=(5.0, 0.0, 0.0))

#: A block of 30 x 20 x 10 mm with a notch: hollow faces of five corners at top and bottom; volume 4,500 mm^3.
NOTCHED = [(0, 0), (30, 0), (15, 10), (30, 20), (0, 20)]
NOTCHED_PLACES = [(x, y, z) for z in (0, 10) for x, y in NOTCHED]
NOTCHED_FACES = [
    [4, 3, 2, 1, 0],
    [5, 6, 7, 8, 9],
    *([i, (i + 1) % 5, 5 + (i + 1) % 5, 5 + i] for i in range(5)),
]


def read(folder, name, content):
    """Read a surface from a file of this name and content."""
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    return read_triangles(folder / name)


def lines(rows, before=""):
    return "".join(before + " ".join(map(str, row)) + "\n" for row in rows)


def same_triangles(found, vertices, triangles):
    """Whether two surfaces have the same triangles at the same places, whatever their order and first corner."""
    two = [np.sort(np.round(c, 4).reshape(-1, 9), axis=0) for c in (found.corners, vertices[triangles])]
    return found.volume == pytest.approx(volume((vertices, triangles)), rel=1e-5) and np.allclose(*two, atol=1e-3)


# --- faces of many corners ---


@pytest.mark.parametrize("first", range(5))
def test_a_hollow_face_is_cut_inside_itself_whatever_corner_is_first(first):
    places = np.array([(x, y, 7.0) for x, y in NOTCHED])
    face = np.roll(np.arange(5), first)
    for order in (face, face[::-1]):
        triangles = cut(places, order[None])
        normals = np.cross(
            places[triangles[:, 1]] - places[triangles[:, 0]], places[triangles[:, 2]] - places[triangles[:, 0]]
        )
        assert np.abs(normals[:, 2]).sum() / 2 == pytest.approx(450.0)
        assert (normals[:, 2] > 0).all() if order is face else (normals[:, 2] < 0).all()


def test_a_face_like_a_comb_a_corner_on_an_edge_and_a_hole_joined_to_the_rim_are_cut():
    comb = [(0.0, 0.0), (50.0, 0.0)] + [(50.0 - 5 * i, 20.0 if i % 2 else 2.0) for i in range(10)] + [(0.0, 20.0)]
    onedge = [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]
    hole = [(0, 0), (30, 0), (30, 30), (0, 30), (0, 0), (10, 10), (10, 20), (20, 20), (20, 10), (10, 10)]
    for corners in (comb, onedge, hole):
        places = np.array([(x, y, x + y) for x, y in corners], float)
        triangles = cut(places, np.arange(len(places))[None])
        a, b, c = (places[triangles[:, i], :2] for i in range(3))
        areas = 0.5 * np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2]
        x, y = places[:, 0], places[:, 1]
        whole = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        assert areas.sum() == pytest.approx(whole)
        assert (areas > 1e-9).all()


def test_faces_that_name_no_vertex_or_have_two_corners_are_refused():
    places = np.zeros((4, 3))
    with pytest.raises(MeshError, match="faces must name vertices 0 to 3, got 4"):
        cut(places, np.array([[0, 1, 2, 4]]))
    with pytest.raises(FormatError, match="three corners or more; 1 have 2"):
        cut(places, np.array([[0, 1]]))
    zigzag = np.array([(i, i % 2, 0) for i in range(2501)] + [(2500, 50, 0)], float)
    with pytest.raises(FormatError, match="at most 2000 corners, got 2502"):
        cut(zigzag, np.arange(2502)[None])


# --- .obj ---


def test_an_obj_counts_back_from_each_face_through_all_its_objects(tmp_path):
    parts = []
    for name, (vertices, triangles) in (("a", BOX), ("b", (BALL[0] + 90.0, BALL[1]))):
        parts.append(f"o {name}\ng {name}\nusemtl skin\n" + lines(vertices, "v "))
        parts.append(lines(triangles - len(vertices), "f "))
    found = read(tmp_path, "two.obj", "".join(parts))
    assert found.volume == pytest.approx(volume(BOX) + volume(BALL), rel=1e-9)
    assert len(found.triangles) == len(BOX[1]) + len(BALL[1])


@pytest.mark.parametrize("form", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "-{1}/-{1}"])
def test_corners_may_name_textures_and_normals(tmp_path, form):
    head = lines(BOX[0], "v ") + "vt 0 0\nvn 0 0 1\n"
    rows = [[form.format(i + 1, len(BOX[0]) - i) for i in row] for row in BOX[1]]
    assert same_triangles(read(tmp_path, "a.obj", head + lines(rows, "f ")), *BOX)


def test_an_obj_may_hold_polygons_colours_continued_lines_and_vertices_after_their_faces(tmp_path):
    rows = lines([[i + 1 for i in face] for face in NOTCHED_FACES], "f ").replace("f 5 4 3", "f 5 4 \\\r\n 3")
    places = "\r\n".join(f"v {x} {y} {z} 1.0 0.5 0.2" for x, y, z in NOTCHED_PLACES)
    found = read(tmp_path, "a.obj", f"mtllib a.mtl\r\no l#1 \xe4\r\n{rows}l 1 2\np 3\ns off\n{places}")
    assert found.volume == pytest.approx(4500.0)
    assert found.areas.sum() == pytest.approx(2 * 450.0 + 10.0 * (80.0 + 2 * np.hypot(15, 10)))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("f 1 2 99", r"vertices 1 to 8, or -1 and so on backwards; it does not at .*a\.obj line 9"),
        ("f 1 2 -9", "it does not at .* line 9"),
        ("f 1 2 0", "three vertices or more, each as .* got '1 2 0' at .* line 9"),
        ("f 1 2", "got '1 2' at .* line 9"),
        ("f 1 2 x", "got '1 2 x'"),
        ("v 1 2", "a vertex must be three numbers, got '1 2' at .* line 9"),
        ("v 1 2 3,5", "got '1 2 3,5'"),
        ("call b.obj", "hold all its faces itself; at line 9 it takes in those of another file"),
        ("surf 0 1 0 1 1 2 3", "must be made of faces; it holds a free-form surface at line 9"),
    ],
)
def test_a_spoilt_line_of_an_obj_is_named(tmp_path, line, words):
    with pytest.raises(FormatError, match=words) as caught:
        read(tmp_path, "a.obj", lines(BOX[0], "v ") + line + "\n" + lines(BOX[1] + 1, "f "))
    assert caught.value.where == f"{tmp_path / 'a.obj'}:9"


# --- .off ---


@pytest.mark.parametrize(
    "head", ["OFF\n{} {} 0\n", "OFF {} {} 0\n", "# made by hand\nOFF # so\n\n{} {}\n", "COFF\r\n{} {} 1\r\n"]
)
def test_an_off_holds_polygons_comments_and_colours(tmp_path, head):
    places = lines([(*place, 0.5, 0.5, 1, 1) for place in NOTCHED_PLACES]) if "COFF" in head else lines(NOTCHED_PLACES)
    faces = lines([(len(face), *face, 255, 0, 0) for face in NOTCHED_FACES])
    found = read(tmp_path, "a.off", head.format(10, 7) + places + "# faces\n\n" + faces)
    assert found.volume == pytest.approx(4500.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("OFF", "4OFF", "must begin with OFF"),
        ("OFF", "OFF BINARY", "be text, got 'OFF BINARY'"),
        ("OFF", "", "must begin with OFF"),
        ("10 7", "10 6", "10 vertices and 6 faces, a line each; it holds 17 lines"),
        ("10 7", "10 seven", "numbers of vertices and faces must be whole numbers"),
        ("0 0 0\n", "0 0\n", r"a vertex must be three numbers, got '0 0' at .*a\.off line 3"),
        ("5 4 3 2 1 0", "5 4 3 2 1 10", "vertices 0 to 9, got '5 4 3 2 1 10' at .* line 13"),
        ("5 4 3 2 1 0", "6 4 3 2 1 0", "must be whole numbers, 6 or more"),
        ("5 4 3 2 1 0", "2 4 3", "must be whole numbers, 3 or more"),
    ],
)
def test_a_spoilt_off_is_refused(tmp_path, old, new, words):
    whole = "OFF\n10 7\n" + lines(NOTCHED_PLACES) + lines([(len(face), *face) for face in NOTCHED_FACES])
    with pytest.raises(FormatError, match=words):
        read(tmp_path, "a.off", whole.replace(old, new, 1))


# --- .stl ---


def letters(surface, name="a b", end="\n"):
    """Return a solid of an .stl in text."""
    facets = [
        f"  facet normal 0 0 0{end}    outer loop{end}"
        + "".join(f"      vertex {x:.9e} {y:.9e} {z:.9e}{end}" for x, y, z in surface[0][row])
        + f"    endloop{end}  endfacet{end}"
        for row in surface[1]
    ]
    return f"solid {name}{end}" + "".join(facets) + f"endsolid {name}{end}"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_all_solids_of_an_stl_in_text_are_read(tmp_path, end):
    far = (BALL[0] + 90.0, BALL[1])
    found = read(tmp_path, "a.stl", letters(BOX, end=end) + letters(far, "solid vertex", end).upper())
    assert found.volume == pytest.approx(volume(BOX) + volume(BALL), rel=1e-6)
    assert len(found.vertices) == len(BOX[0]) + len(BALL[0])


def test_a_mark_at_the_beginning_of_a_text_does_not_matter(tmp_path):
    for name, content in (("a.stl", letters(BOX).encode()), ("a.ply", ply("ascii"))):
        assert read(tmp_path, name, b"\xef\xbb\xbf" + content).volume > 0.0


def test_a_binary_stl_may_begin_like_a_text(tmp_path):
    assert same_triangles(read_triangles(write_stl(tmp_path / "a.stl", BALL, head=b"solid of bytes")), *BALL)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("endsolid", "", "its last one does not end"),
        ("endloop", "", r"outer loop of three vertices, x y z; it is not at .*a\.stl line 10"),
        ("vertex", "vertx", "it is not at .* line 7"),
        ("outer loop", "", "it is not at .* line 4"),
        ("vertex", "vertex 1", "it is not at .* line 4"),
        ("vertex 5", "vertex five", "a vertex must be three numbers, got 'five"),
    ],
)
def test_a_spoilt_stl_in_text_is_refused_by_line(tmp_path, old, new, words):
    with pytest.raises(FormatError, match=words):
        read(tmp_path, "a.stl", letters(BOX).replace(old, new, 1))


# --- .ply ---


def ply(order, corners="list uchar int vertex_indices", faces=NOTCHED_FACES, head="", tail=()):
    """Return a .ply of the notched block with a property before the coordinates and an element between."""
    lengths = [len(face) for face in faces]
    text = (
        f"ply\nformat {order} 1.0\n{head}element vertex 10\nproperty uchar red\nproperty double x\nproperty float y\n"
        "property int z\nelement edge 2\nproperty short one\nproperty list uchar float more\n"
        f"element face {len(faces)}\nproperty {corners}\nproperty float quality\nend_header\n"
    )
    rows = [("u1 f8 f4 i4", [9, *place]) for place in NOTCHED_PLACES]
    rows += [("i2 u1 f4 f4", [1, 2, 0.5, 0.25]), ("i2 u1", [2, 0])]
    kinds = {"uchar": "u1", "int": "i4", "uint": "u4", "ushort": "u2"}
    before, kind = (kinds[word] for word in corners.split()[1:3])
    rows += [(" ".join([before, *[kind] * k, "f4"]), [k, *face, 0.5]) for k, face in zip(lengths, faces, strict=True)]
    if order == "ascii":
        return (text + lines(values for _, values in rows) + lines([tail] if tail else [])).encode()
    sign = "<" if "little" in order else ">"
    body = [
        np.array(v, sign + k).tobytes() for kinds, values in rows for k, v in zip(kinds.split(), values, strict=True)
    ]
    return text.encode() + b"".join(body) + bytes(tail)


@pytest.mark.parametrize(
    ("order", "corners"),
    [
        (order, corners)
        for order in ("ascii", "binary_little_endian", "binary_big_endian")
        for corners in ("list uchar int vertex_indices", "list ushort uint vertex_index")
    ],
)
def test_a_ply_holds_polygons_and_other_elements_in_any_order_of_bytes(tmp_path, order, corners):
    assert read(tmp_path, "a.ply", ply(order, corners)).volume == pytest.approx(4500.0)
    cut_faces = [[f[0], f[i], f[i + 1]] for f in NOTCHED_FACES for i in range(1, len(f) - 1)]
    assert read(tmp_path, "b.ply", ply(order, corners, cut_faces)).volume == pytest.approx(4500.0)


@pytest.mark.parametrize("order", ["ascii", "binary_big_endian"])
def test_a_comment_of_a_ply_may_hold_any_words(tmp_path, order):
    head = "comment before end_header of \u00c5lesund, SPACE=RAS\n"  # one of its bytes ends lines elsewhere
    found = read(tmp_path, "a.ply", ply(order).replace(b"element vertex", head.encode() + b"element vertex"))
    assert (found.volume, found.frame) == (pytest.approx(4500.0), "RAS")


@pytest.mark.parametrize("order", ["ascii", "binary_big_endian"])
def test_a_ply_that_does_not_hold_what_its_header_says_is_refused(tmp_path, order):
    whole = ply(order)
    for spoilt, words in (
        (whole[:-5], "it ends before its header says"),
        (ply(order, tail=(7, 7)), "more follows than its header says"),
        (whole.replace(b"face 7", b"face 8"), "it ends before its header says"),
        (whole.replace(b"double x", b"double u"), "elements 'vertex' with x, y, z; 'x' is missing"),
        (whole.replace(b"vertex_indices", b"corners"), "must hold the faces of a surface, with vertex_indices"),
        (whole.replace(b"float quality", b"floot quality"), "its header holds 'property floot quality'"),
        (whole.replace(b"format", b"comment"), "its header states no format"),
        (whole.replace(b"end_header", b"and_header"), "its header does not end"),
    ):
        with pytest.raises(FormatError, match=words):
            read(tmp_path, "a.ply", spoilt)
    with pytest.raises(MeshError, match=r"a\.ply: faces must name vertices 0 to 9, got 10"):
        read(tmp_path, "a.ply", ply(order, faces=[[0, 1, 10]]))


# --- as other programs write and read them ---


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_what_vtk_writes_is_read_as_vtk_reads_it(tmp_path, suffix):
    pyvista = pytest.importorskip("pyvista", reason="the extra `mesh` is not installed")
    faces = np.concatenate([[len(face), *face] for face in NOTCHED_FACES])
    block = pyvista.PolyData(np.array(NOTCHED_PLACES, np.float32), faces)
    for binary in (True, False):
        (block.triangulate() if suffix == "stl" else block).save(tmp_path / f"a.{suffix}", binary=binary)
        found, told = read_triangles(tmp_path / f"a.{suffix}"), pyvista.read(tmp_path / f"a.{suffix}").triangulate()
        assert found.volume == pytest.approx(told.volume, rel=1e-6)
        assert found.areas.sum() == pytest.approx(told.area, rel=1e-6)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "off"])
def test_what_trimesh_writes_is_the_surface_that_it_wrote(tmp_path, kind):
    for surface in (BALL, BOX):
        file = tmp_path / f"a.{kind[:3]}"
        trimesh.Trimesh(*surface, process=False).export(file, file_type=kind)
        assert same_triangles(read_triangles(file), *surface)


# --- the frame that a file states ---


def with_note(folder, suffix, note):
    """Write a ball with a note where that kind of file has room for one."""
    vertices, triangles = BALL
    body = {
        "obj": f"# {note}\n" + lines(vertices, "v ") + lines(triangles + 1, "f "),
        "off": f"OFF\n# {note}\n{len(vertices)} {len(triangles)} 0\n"
        + lines(vertices)
        + lines(np.insert(triangles, 0, 3, 1)),
        "ply": f"ply\nformat ascii 1.0\ncomment {note}\nelement vertex {len(vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n" + lines(vertices) + lines(np.insert(triangles, 0, 3, 1)),
        "letters": letters(BALL, note),
    }
    if suffix == "stl":
        return write_stl(folder / "a.stl", BALL, head=note.encode())
    file = folder / f"a.{'stl' if suffix == 'letters' else suffix}"
    file.write_text(body[suffix])
    return file


@pytest.mark.parametrize("suffix", ["stl", "letters", "ply", "obj", "off"])
@pytest.mark.parametrize(
    ("note", "frame", "extent"),
    [
        ("3D Slicer output. SPACE=RAS", "RAS", 40.0),
        ("SPACE=LPS UNITS=cm", "LPS", 400.0),
        ("space: left-posterior-superior", "LPS", 40.0),
        ("made in a space of 20 x 30", None, 40.0),
        ("airspace=RAS", None, 40.0),
    ],
)
def test_a_surface_that_states_its_frame_keeps_it(tmp_path, suffix, note, frame, extent):
    file = with_note(tmp_path, suffix, note)
    assert (read_triangles(file).frame, read_triangles(file).extent) == (frame, pytest.approx(extent, rel=1e-6))


@pytest.mark.parametrize("note", ["SPACE=LAS", "SPACE=right-anterior-inferior", "SPACE=RAS SPACE=LPS"])
def test_another_frame_or_two_are_refused(tmp_path, note):
    with pytest.raises(FormatError, match=r"a\.obj: the frame that a file states must be LPS or RAS, got"):
        read_triangles(with_note(tmp_path, "obj", note))


def test_a_frame_that_is_given_must_be_that_of_the_file(tmp_path):
    file = with_note(tmp_path, "stl", "SPACE=RAS")
    assert read_triangles(file, frame="RAS").frame == "RAS"
    with pytest.raises(FormatError, match=r"a\.stl is in RAS, --frame LPS .* contradicts it"):
        read_triangles(file, frame="LPS")
    assert read_triangles(BALL, frame="LPS").frame == "LPS"
    with pytest.raises(FormatError, match="`frame` must be one of LPS, RAS"):
        read_triangles(BALL, frame="IJK")
    with pytest.raises(MeshError, match="`frame` must be one of LPS, RAS"):
        Triangles(*BALL, frame="ras")


# --- a small input that went wrong before ---


def test_two_organs_with_negative_indices_are_both_read(shared_data):
    found = read_triangles(shared_data / "cases" / "obj-relative" / "two_organs_relative.obj")
    assert found.volume == pytest.approx(265_775 + 33_222, rel=0.03)  # facets lie inside the round bodies
