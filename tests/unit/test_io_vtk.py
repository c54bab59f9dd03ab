"""VTK's files in every form, next to VTK itself where it is installed."""

import itertools
import sys

import numpy as np
import pytest

import tissuereg as tr
from support.grids import VTK, array, piece, write_appended_vtu, write_grid, write_modern_vtk, write_pieces
from support.meshes import block
from support.surfaces import volume
from tissuereg.errors import FormatError
from tissuereg.io.foreign import read_grid
from tissuereg.io.lz4 import unpacked_lz4
from tissuereg.io.meshes import write_vtu
from tissuereg.io.surfaces import read_triangles

MESH = block(cells=(2, 1, 2))
NUMBERS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")


@pytest.fixture(scope="module")
def by_vtk():
    """VTK, a grid of it with numbers of every type, and what it says that the grid holds."""
    pyvista = pytest.importorskip("pyvista", reason="the extra `mesh` is not installed")
    import vtk

    grid = pyvista.UnstructuredGrid({vtk.VTK_TETRA: MESH.tets}, MESH.nodes)
    for kind in NUMBERS:
        grid.point_data[f"held by {kind}"] = (MESH.nodes[:, 2] == 0).astype(kind)
    bits = vtk.vtkBitArray()
    bits.SetName("held by bits")
    for held in MESH.nodes[:, 2] == 0:
        bits.InsertNextValue(int(held))
    grid.GetPointData().AddArray(bits)
    grid.point_data["displacement"] = 0.1 * MESH.nodes
    grid.field_data["SPACE"] = ["RAS"]
    return vtk, grid


def holds_all(path):
    """A file by VTK is read as what was written."""
    mesh, content = tr.read_mesh(path), read_grid(path, "mesh")
    assert np.allclose(mesh.nodes, MESH.nodes, rtol=1e-6)
    assert np.array_equal(mesh.tets, MESH.tets)
    assert {name: len(nodes) for name, nodes in mesh.node_sets.items()} == {
        f"held by {k}": 6 for k in (*NUMBERS, "bits")
    }
    assert np.allclose(content.point_data["displacement"], 0.1 * MESH.nodes, rtol=1e-6)
    assert mesh.frame == "RAS"


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended", "raw"])
def test_xml_is_read_as_vtk_writes_it(by_vtk, tmp_path, mode):
    vtk, grid = by_vtk
    kinds = itertools.product(range(4), ("Little", "Big"), (32, 64))
    for packed, order, header in kinds if mode != "Ascii" else [(0, "Little", 32)]:
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetInputData(grid)
        writer.SetFileName(str(tmp_path / "b.vtu"))
        getattr(writer, f"SetDataModeTo{'Appended' if mode == 'raw' else mode}")()
        writer.SetEncodeAppendedData(mode == "Appended")
        writer.SetCompressorType(packed)  # none, zlib, LZ4, LZMA
        writer.SetBlockSize(512)
        getattr(writer, f"SetByteOrderTo{order}Endian")()
        getattr(writer, f"SetHeaderTypeToUInt{header}")()
        writer.Write()
        holds_all(tmp_path / "b.vtu")


@pytest.mark.parametrize(("version", "binary"), [(42, 1), (42, 2), (51, 1), (51, 2)])
def test_legacy_files_are_read_as_vtk_writes_them(by_vtk, tmp_path, version, binary):
    vtk, grid = by_vtk
    writer = vtk.vtkUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(tmp_path / "b.vtk"))
    writer.SetFileVersion(version)
    writer.SetFileType(binary)
    writer.Write()
    holds_all(tmp_path / "b.vtk")


def test_what_we_write_vtk_reads(by_vtk, tmp_path):
    import pyvista

    field = np.linspace(0.0, 1.0, MESH.n_nodes)
    write_vtu(tmp_path / "b.vtu", MESH.in_frame("LPS"), {"std_mm": field, "u_mm": MESH.nodes}, says="a_note")
    found = pyvista.read(tmp_path / "b.vtu")
    assert np.array_equal(found.points, MESH.nodes)
    assert np.array_equal(found.cells_dict[10], MESH.tets)
    assert np.array_equal(found.point_data["std_mm"], field)
    assert np.array_equal(found.point_data["u_mm"], MESH.nodes)
    assert found.field_data["SPACE"][0] == "LPS"
    assert "a_note" in found.field_data
    assert tr.read_mesh(tmp_path / "b.vtu").frame == "LPS"


@pytest.mark.parametrize("mode", ["vtp", "legacy text", "legacy binary"])
def test_strips_and_polygons_are_cut_as_vtk_cuts_them(by_vtk, tmp_path, mode):
    import pyvista

    # A prism over an L, whose base has a corner that turns inwards; one side is a strip.
    outline = np.array([[0, 0], [40, 0], [40, 20], [20, 20], [20, 60], [0, 60]], float)
    points = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 30.0)])
    sides = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(1, 6)]
    faces = [[*range(5, -1, -1)], [*range(6, 12)], *sides]
    body = pyvista.PolyData(points, faces=np.concatenate([[len(face), *face] for face in faces]))
    body.strips = [4, 0, 1, 6, 7]
    path = tmp_path / ("b.vtp" if mode == "vtp" else "b.vtk")
    body.save(path, binary=mode != "legacy text")
    found = read_triangles(path)
    assert found.volume == pytest.approx(48000.0)
    assert volume((found.vertices, found.triangles)) == pytest.approx(48000.0)
    assert len(found.triangles) == len(body.triangulate().faces) // 4


def test_text_fields_metadata_ids_and_spaces_in_names_are_read(tmp_path):
    mesh = tr.read_mesh(write_modern_vtk(tmp_path / "b.vtk", MESH.nodes, MESH.tets))
    assert (mesh.frame, sorted(mesh.node_sets)) == ("RAS", ["fixed", "low end"])
    assert mesh.digest() == MESH.digest()


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("packed", ["", "zlib", "lzma", "lz4"])
def test_appended_arrays_are_read(tmp_path, packed, raw):
    path = write_appended_vtu(tmp_path / "b.vtu", MESH.nodes, MESH.tets, packed, raw, order=">", header="u8")
    assert tr.read_mesh(path).digest() == MESH.digest()


def test_whole_numbers_called_long_have_eight_bytes_or_the_four_of_windows(tmp_path):
    cells = [("tetra", MESH.tets)]
    path = write_grid(tmp_path / "b.vtk", MESH.nodes, cells, {"fixed": (MESH.nodes[:, 2] == 0) * 1}, binary=True)
    four = path.read_bytes().replace(b"SCALARS fixed int", b"SCALARS fixed long")
    head, _ = four.split(b"LOOKUP_TABLE default\n")
    eight = head + b"LOOKUP_TABLE default\n" + (MESH.nodes[:, 2] == 0).astype(">i8").tobytes() + b"\n"
    for content in (four, eight):
        path.write_bytes(content)
        assert tr.read_mesh(path).digest() == MESH.digest()


def test_pieces_of_a_file_are_one_body_and_cells_of_others_are_left_out(tmp_path):
    left = MESH.nodes[MESH.tets].mean(axis=1)[:, 0] < 15
    parts = []
    for own in (left, ~left):
        used, tets = np.unique(MESH.tets[own], return_inverse=True)
        held = {"fixed": (MESH.nodes[used, 2] == 0).astype(np.int8)} if own is left else {}
        parts.append(piece(MESH.nodes[used], [("tetra", tets.reshape(-1, 4))], held))
    with pytest.warns(UserWarning, match=r"6 nodes .* joined with it \(pieces of the file meet there\)"):
        mesh = tr.read_mesh(write_pieces(tmp_path / "b.vtu", parts))
    assert (mesh.n_nodes, mesh.n_tets) == (MESH.n_nodes, MESH.n_tets)
    assert mesh.volumes.sum() == pytest.approx(24000.0)
    assert np.unique(mesh.nodes[mesh.fixed_nodes, 0]).tolist() == [0.0, 15.0]  # of the piece that states it
    for name in ("vtkGhostType", "vtkGhostLevels"):
        ghost = f"<CellData>{array(name, (~left).astype(np.uint8))}</CellData></Piece>"
        whole = piece(MESH.nodes, [("tetra", MESH.tets)], {}).replace("</Piece>", ghost)
        with pytest.warns(UserWarning, match="nodes that belong to no tetrahedron"):
            assert tr.read_mesh(write_pieces(tmp_path / "g.vtu", [whole])).n_tets == left.sum()


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_pieces_that_overlap_count_once_and_one_may_lack_an_array(tmp_path, kind):
    body = block()
    middle = body.nodes[body.tets].mean(axis=1)[:, 0]
    parts = []
    for own in (middle < 16, middle > 8, np.ones(len(middle), bool)):
        used, tets = np.unique(body.tets[own], return_inverse=True)
        held = {"fixed": (body.nodes[used, 2] == 0).astype(kind)} if own.all() else {}
        parts.append(piece(body.nodes[used], [("tetra", tets.reshape(-1, 4))], held))
    joined, once = (pytest.warns(UserWarning, match=words) for words in ("pieces of the file meet", "they count once"))
    with joined, once:
        mesh = tr.read_mesh(write_pieces(tmp_path / "b.vtu", parts))
    assert (mesh.n_nodes, mesh.n_tets, len(mesh.surface)) == (body.n_nodes, body.n_tets, len(body.surface))
    assert len(mesh.fixed_nodes) == len(body.fixed_nodes)


@pytest.mark.parametrize("kind", [24, 71, 78], ids=["quadratic", "Lagrange", "Bezier"])
def test_tets_of_any_order_are_their_corners(tmp_path, monkeypatch, kind):
    monkeypatch.setitem(VTK, "tetra", kind)
    more = np.arange(6) if kind == 24 else []
    tets = np.hstack([MESH.tets, np.tile(np.array(more, int), (MESH.n_tets, 1))])
    assert tr.read_mesh(write_grid(tmp_path / "b.vtu", MESH.nodes, [("tetra", tets)])).digest() != ""


@pytest.mark.parametrize(
    ("head", "frame", "unit"),
    [
        ("<!-- SPACE=RAS -->", "RAS", 1.0),
        ('<FieldData><Array type="String" Name="SPACE" format="ascii">76 80 83 0</Array></FieldData>', "LPS", 1.0),
        ("<!-- made in 3D; SPACE: left-posterior-superior, UNITS=cm -->", "LPS", 10.0),
        ("<!-- unit: mm -->", None, 1.0),
        ("<!-- a space between -->", None, 1.0),
    ],
)
def test_frame_and_unit_that_a_file_states_are_believed(tmp_path, head, frame, unit):
    path = write_grid(tmp_path / "b.vtu", MESH.nodes, [("tetra", MESH.tets)], head=head)
    mesh = tr.read_mesh(path)
    assert mesh.frame == frame
    assert np.array_equal(mesh.nodes, unit * MESH.nodes)


def test_a_title_states_the_frame_and_another_one_is_refused(tmp_path):
    path = write_grid(tmp_path / "b.vtk", MESH.nodes, [("tetra", MESH.tets)], title="3D Slicer output. SPACE=RAS")
    assert tr.read_mesh(path, frame="RAS").frame == "RAS"
    with pytest.raises(FormatError, match=r"b\.vtk is in RAS, --frame LPS .* contradicts it"):
        tr.read_mesh(path, frame="LPS")
    path = write_grid(tmp_path / "b.vtk", MESH.nodes, [("tetra", MESH.tets)], title="SPACE=LAI")
    with pytest.raises(FormatError, match="must be LPS or RAS, got LAI"):
        tr.read_mesh(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"CELL_TYPES 24", b"CELL_TYPES 99999999999", "99999999999 more numbers must follow"),
        (b"POINTS 18 double", b"POINTS 18 quaternion", "of a type that VTK knows, got 'quaternion'"),
        (b"UNSTRUCTURED_GRID", b"STRUCTURED_GRID", "UNSTRUCTURED_GRID or POLYDATA, got STRUCTURED_GRID"),
        (b"SCALARS", b"SCALES", "a keyword of VTK, got 'SCALES'"),
        (b"ASCII", b"TEXT", "ASCII or BINARY, got 'TEXT'"),
    ],
)
def test_what_a_legacy_file_does_not_hold_is_said(tmp_path, old, new, words):
    held = {"fixed": (MESH.nodes[:, 2] == 0) * 1}
    path = write_grid(tmp_path / "b.vtk", MESH.nodes, [("tetra", MESH.tets)], held)
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(FormatError, match=rf"b\.vtk must be a mesh .*{words}"):
        tr.read_mesh(path)


@pytest.mark.parametrize("packed", ["", "zlib", "lz4"])
def test_sizes_that_a_file_claims_take_no_memory(tmp_path, packed):
    path = write_appended_vtu(tmp_path / "b.vtu", MESH.nodes, MESH.tets, packed, header="u8")
    content = path.read_bytes()
    begin = content.index(b"\n_") + 2 + (0 if not packed else 16)
    path.write_bytes(content[:begin] + (2**40).to_bytes(8, "little") + content[begin + 8 :])
    with pytest.raises(FormatError, match=r"must have|at most"):
        tr.read_mesh(path)


def test_a_document_type_is_refused(tmp_path):
    path = write_grid(tmp_path / "b.vtu", MESH.nodes, [("tetra", MESH.tets)])
    path.write_text(path.read_text().replace("<VTKFile", '<!DOCTYPE a [<!ENTITY b "c">]><VTKFile', 1))
    with pytest.raises(FormatError, match="no document type"):
        tr.read_mesh(path)


def test_an_lz4_block_is_unpacked_or_refused():
    assert unpacked_lz4(b"\x13a\x01\x00\x50bcdef", 13) == b"a" * 8 + b"bcdef"
    assert unpacked_lz4(b"\x1fa\x01\x00\xff\xff\x0a\x10b", 541) == b"a" * 540 + b"b"
    for spoilt in (b"\x13a\x02\x00\x50bcdef", b"\x13a\x00\x00\x50bcdef", b"\x13a", b"\xff\xff", b""):
        with pytest.raises(FormatError, match="LZ4 block must hold 13 bytes"):
            unpacked_lz4(spoilt, 13)


def test_nothing_of_vtk_is_loaded_by_a_reader(tmp_path):
    assert "tissuereg.io.vtk_xml" in sys.modules
    assert not {"vtk", "pyvista"} & set(vars(sys.modules["tissuereg.io.vtk_xml"]))
