"""Meshes from files: what comes in, what is dropped, what is refused."""

import numpy as np
import pytest

import tissuereg as tr
from support.grids import write_grid
from tissuereg.errors import FormatError, MeshError, ShapeError
from tissuereg.io.foreign import read_grid
from tissuereg.io.meshes import write_vtu
from tissuereg.io.node_rules import nodes_by_rule, rule_for_file
from tissuereg.io.triangles_out import write_triangles

MID_EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]


def second_order(mesh: tr.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and ten-node tets on the same edges, mid-edge nodes behind the corners."""
    pairs = np.sort(mesh.tets[:, MID_EDGES], axis=2)
    edges, number = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    middles = mesh.nodes[edges].mean(axis=1)
    return np.vstack([mesh.nodes, middles]), np.hstack([mesh.tets, mesh.n_nodes + number.reshape(-1, 6)])


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
def test_node_sets_come_from_zero_one_point_data_of_any_name(block_mesh, tmp_path, suffix):
    held = (block_mesh.nodes[:, 2] == 0).astype(float)
    top = (block_mesh.nodes[:, 2] == 40).astype(np.int32)
    height = block_mesh.nodes[:, 2]
    point_data = {"fixed": held, "top": top, "height": height}
    write_grid(tmp_path / f"b.{suffix}", block_mesh.nodes, [("tetra", block_mesh.tets)], point_data)
    mesh = tr.read_mesh(tmp_path / f"b.{suffix}")
    assert sorted(mesh.node_sets) == ["fixed", "top"]
    assert np.array_equal(mesh.node_set("top"), np.flatnonzero(top))
    assert mesh.digest() == block_mesh.digest()


def test_what_is_written_is_read_back_bit_for_bit(block_mesh, tmp_path):
    moved = np.linspace(0.0, 1.0, 3 * block_mesh.n_nodes).reshape(-1, 3)
    write_vtu(tmp_path / "out.vtu", block_mesh, {"displacement_mm": moved, "std_mm": moved[:, 0]})
    back = read_grid(tmp_path / "out.vtu", "mesh")
    assert np.array_equal(back.point_data["displacement_mm"], moved)
    assert np.array_equal(back.point_data["std_mm"], moved[:, 0])
    assert np.array_equal(tr.read_mesh(tmp_path / "out.vtu").nodes, block_mesh.nodes)


def test_values_of_another_length_are_not_written(block_mesh, tmp_path):
    with pytest.raises(ShapeError, match="std_mm"):
        write_vtu(tmp_path / "out.vtu", block_mesh, {"std_mm": np.zeros(3)})
    assert list(tmp_path.iterdir()) == []


def test_physical_groups_of_gmsh_are_node_sets(block_mesh, tmp_path):
    base = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] == 0).all(axis=1)]
    cells = [("triangle", base), ("tetra", block_mesh.tets)]
    names = '2\n2 7 "fixed"\n3 1 "body"'
    write_grid(tmp_path / "b.msh", block_mesh.nodes, cells, groups=(7, 1), names=names)
    mesh = tr.read_mesh(tmp_path / "b.msh")
    assert np.array_equal(mesh.fixed_nodes, block_mesh.fixed_nodes)
    assert len(mesh.node_set("body")) == block_mesh.n_nodes


def test_ten_node_tets_lose_their_mid_edge_nodes_with_a_warning(block_mesh, tmp_path):
    nodes, tets = second_order(block_mesh)
    fixed = (nodes[:, 2] == 0).astype(int)
    write_grid(tmp_path / "b.vtu", nodes, [("tetra10", tets)], {"fixed": fixed})
    with pytest.warns(UserWarning, match=rf"{len(nodes) - block_mesh.n_nodes} mid-edge nodes .* were dropped"):
        mesh = tr.read_mesh(tmp_path / "b.vtu")
    assert mesh.digest() == block_mesh.digest()


def test_a_node_set_without_a_corner_of_a_tet_is_told(block_mesh, tmp_path):
    nodes = np.vstack([block_mesh.nodes, [[1.0, 2.0, 3.0]]])
    flags = {"fixed": (np.arange(len(nodes)) == block_mesh.n_nodes) * 1}
    path = write_grid(tmp_path / "b.vtu", nodes, [("tetra", block_mesh.tets)], flags)
    empty = pytest.warns(UserWarning, match="node set 'fixed' is empty: none of its 1 points is the corner")
    with empty, pytest.warns(UserWarning, match="belong to no tetrahedron"):
        assert len(tr.read_mesh(path).node_sets["fixed"]) == 0


def test_nodes_of_no_tet_are_dropped_with_a_warning(block_mesh, tmp_path):
    nodes = np.vstack([[[99.0, 99.0, 99.0]], block_mesh.nodes])
    write_grid(tmp_path / "b.vtu", nodes, [("tetra", block_mesh.tets + 1)], {"fixed": (nodes[:, 2] == 0) * 1})
    with pytest.warns(UserWarning, match="1 nodes that belong to no tetrahedron"):
        mesh = tr.read_mesh(tmp_path / "b.vtu")
    assert mesh.digest() == block_mesh.digest()


def test_an_archive_brings_nodes_tets_and_node_sets(block_mesh, tmp_path):
    np.savez(
        tmp_path / "b.npz",
        nodes_mm=block_mesh.nodes.astype(np.float32),
        tets=block_mesh.tets.astype(np.uint16),
        fixed_nodes=block_mesh.fixed_nodes[::-1],
        pad_nodes=[3, 4],
        n_nodes=12,
    )
    mesh = tr.read_mesh(tmp_path / "b.npz")
    assert np.array_equal(mesh.fixed_nodes, block_mesh.fixed_nodes)
    assert mesh.node_set("pad").tolist() == [3, 4]
    assert sorted(mesh.node_sets) == ["fixed", "pad"]


@pytest.mark.parametrize(
    "rule",
    [
        "plane 0 0 1 40 0.1",
        "plane 0 0 -3 -40",
        (0, 0, 2, 40, 0.5),
        (0, 0, 1, 40.05),
        {"plane": [0, 0, 1, 40.05]},
        {"plane": [0, 0, 1, 39.5], "tolerance_mm": 0.5},
        "{ plane = [0, 0, 1, 39.5], tolerance_mm = 0.5 }",
        "ball 15 10 100 63",
        {"centre_mm": [15, 10, 100], "radius_mm": 63},
        "{ centre_mm = [15, 10, 100], radius_mm = 63 }",
        "top",
    ],
    ids=[
        "text",
        "turned",
        "numbers",
        "usual tolerance",
        "table, usual tolerance",
        "table",
        "table as text",
        "ball",
        "ball table",
        "ball table as text",
        "set",
    ],
)
def test_what_is_fixed_can_be_said_as_a_plane_or_a_set(block_mesh, tmp_path, rule):
    top = np.flatnonzero(block_mesh.nodes[:, 2] == 40)
    write_vtu(tmp_path / "b.vtu", block_mesh.with_node_set("top", top))
    assert np.array_equal(tr.read_mesh(tmp_path / "b.vtu", fixed=rule).fixed_nodes, top)


def test_nodes_near_a_surface_and_in_a_box_are_chosen(block_mesh, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = block_mesh.in_frame("LPS")
    write_vtu(tmp_path / "b.vtu", mesh)
    # A plate 2 mm beside the face x = 30, over its lower half, in the other patient frame.
    plate = np.array([[32.0, -5.0, 0.0], [32.0, 25.0, 0.0], [32.0, 25.0, 20.0], [32.0, -5.0, 20.0]])
    write_triangles(tmp_path / "the plate.stl", tr.Triangles(plate * [-1, -1, 1], [[0, 1, 2], [0, 2, 3]], "RAS"))
    x, z = mesh.nodes[:, 0], mesh.nodes[:, 2]
    chosen = tr.read_mesh(tmp_path / "b.vtu", fixed="near the plate.stl 2.5").fixed_nodes
    assert np.array_equal(chosen, np.flatnonzero((x == 30.0) & (z <= 21.5)))
    boxed = tr.read_mesh(tmp_path / "b.vtu", fixed="box 29 -1 -1 31 30 21").fixed_nodes
    assert np.array_equal(boxed, np.flatnonzero((x == 30.0) & (z <= 21.0)))
    table = {"low_mm": [29, -1, -1], "high_mm": [31, 30, 21]}
    assert np.array_equal(nodes_by_rule(mesh, table), boxed)
    assert rule_for_file("box 29 -1 -1 31 30 21") == table
    with pytest.raises(FormatError, match="a rule that the file itself can hold"):
        rule_for_file("near the plate.stl 2.5")


@pytest.mark.parametrize(
    ("rule", "error", "words"),
    [
        ("plane 0 0 1 77 0.5", MeshError, "nearest is 37 mm away"),
        ("plane 0 0 0 1 0.5", FormatError, "normal not zero"),
        ("plane 0 0 1", FormatError, r"plane nx ny nz d \[tol\]"),
        ("plane 0 0 one 40 0.1", FormatError, r"plane nx ny nz d \[tol\]"),
        ("plane 0 0 1 40.11", MeshError, "within 0.1 mm; the nearest is 0.11 mm away"),
        ({"plane": [0, 0, 1]}, FormatError, "`plane` is a list of 4 numbers"),
        ({"plane": [0, 0, 1, 40], "radius_mm": 3}, FormatError, "a node set, { plane, tolerance_mm } or { centre_mm"),
        ({"centre_mm": [0, 0], "radius_mm": 3}, FormatError, "`centre_mm` is a list of 3 numbers"),
        ({"centre_mm": [0, 0, 60], "radius_mm": True}, FormatError, "radius r positive"),
        ({"plane": [0, 0, True, 1], "tolerance_mm": 3.0}, FormatError, "plane nx ny nz d"),
        ({"plane": [0, 0, 1, 40], "tolerance_mm": True}, FormatError, "plane nx ny nz d"),
        ({"plane": ["0", "0", "1", "40"]}, FormatError, "plane nx ny nz d"),
        ({"centre_mm": [0, 0, 60], "radius_mm": "3"}, FormatError, "radius r positive"),
        ((True, 0, 0, 1), FormatError, "plane nx ny nz d"),
        (b"abcd", FormatError, "name of a node set"),
        ({1.0, 2.0, 3.0, 4.0}, FormatError, "name of a node set"),
        ((10**400, 0, 0, 1), FormatError, "plane nx ny nz d"),
        ("{ plane = [0, 0, 1, " + 5000 * "9" + "] }", FormatError, "one table"),
        ("plane 0 0 1e200 77", MeshError, "nearest is 37 mm away"),
        ("plane 0 0 1e-200 77", MeshError, "nearest is 37 mm away"),
        ("{ plane = [0, 0, 1, 40] ", FormatError, "one table"),
        ("{ plane = [0, 0, 1, 40] }\nx = 1", FormatError, "one table"),
        ("plane 0 0 1 40 -0.1", FormatError, "tol at least 0"),
        ("plane 0 0 1 nan 0.1", FormatError, r"plane nx ny nz d \[tol\]"),
        ("lid", MeshError, "'lid'.*fixed"),
        ("ball 0 0 60 5", MeshError, "within 5 mm of .*nearest is 20 mm away"),
        ("ball 0 0 60", FormatError, "ball x y z r"),
        ("ball 0 0 60 -2", FormatError, "radius r positive"),
        ("ball 0 0 inf 2", FormatError, "ball x y z r"),
        ("box 0 0 50 9 9 60", MeshError, "nearest is 10 mm away"),
        ("box 0 0 5 9 9 5", FormatError, "second corner above the first"),
        ({"low_mm": [0, 0, 0], "high_mm": [1, 1]}, FormatError, "`high_mm` is a list of 3 numbers"),
        ("box", MeshError, "'box'.*fixed"),
        ("near", MeshError, "'near'.*fixed"),
        ("label tumour 3", FormatError, "where a segmentation is meshed"),
        ("near 3", FormatError, "'near FILE r', a surface and a distance above 0 mm"),
        ("near skin.stl -3", FormatError, "'near FILE r'"),
        ("near no such skin.stl 3", FormatError, "no such skin.stl"),
    ],
)
def test_a_rule_that_holds_nothing_is_refused(block_mesh, tmp_path, rule, error, words):
    write_vtu(tmp_path / "b.vtu", block_mesh)
    with pytest.raises(error, match=words):
        tr.read_mesh(tmp_path / "b.vtu", fixed=rule)


def test_a_surface_file_points_to_the_mesher(shared_data):
    with pytest.raises(FormatError, match=r"surface only.*tissuereg mesh \S*beam\.stl --size MM.*tissuereg\[mesh\]"):
        tr.read_mesh(shared_data / "data" / "beam" / "beam.stl")


def test_a_mesh_file_of_triangles_alone_points_to_the_mesher(block_mesh, tmp_path):
    write_grid(tmp_path / "skin.vtu", block_mesh.nodes, [("triangle", block_mesh.surface)])
    with pytest.raises(FormatError, match=r"holds triangle only.*tissuereg mesh \S*skin\.vtu --size MM"):
        tr.read_mesh(tmp_path / "skin.vtu")


def test_a_planar_mesh_is_named_for_what_it_holds(shared_data):
    with pytest.raises(FormatError, match=r"must hold tetrahedra; it holds line, triangle only\. It is flat"):
        tr.read_mesh(shared_data / "data" / "keloid" / "mesh.msh")


def test_cells_that_are_no_tets_are_refused(tmp_path):
    cube = np.array([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0], [0, 0, 9], [9, 0, 9], [9, 9, 9], [0, 9, 9]], float)
    write_grid(tmp_path / "b.vtu", cube, [("hexahedron", [list(range(8))])])
    with pytest.raises(FormatError, match="made of tetrahedra; it also holds cells of kind hexahedron"):
        tr.read_mesh(tmp_path / "b.vtu")


def test_fixed_point_data_must_be_zero_or_one(block_mesh, tmp_path):
    values = {"fixed": np.linspace(0, 1, block_mesh.n_nodes)}
    write_grid(tmp_path / "b.vtu", block_mesh.nodes, [("tetra", block_mesh.tets)], values)
    with pytest.raises(FormatError, match=r"'fixed'.*one 0 or 1 per node"):
        tr.read_mesh(tmp_path / "b.vtu")


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh"])
def test_a_spoilt_file_is_a_format_error_and_prints_nothing(tmp_path, capsys, suffix):
    (tmp_path / f"b.{suffix}").write_bytes(b"\x00\x01 no mesh at all\n" * 9)
    with pytest.raises(FormatError, match=rf"b\.{suffix} must be a mesh of the kind that its name says"):
        tr.read_mesh(tmp_path / f"b.{suffix}")
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "")
