"""How given tets hang together: put right where that is certain, told or refused where it is not."""

import warnings

import numpy as np
import pytest

import tissuereg as tr
from support.grids import write_grid
from support.meshes import block, kuhn
from tissuereg.errors import MeshError, SupportError, UnitError, UnitWarning
from tissuereg.io.fields import read_displacement

MESH = block()
MIDDLE = np.abs(MESH.nodes[MESH.tets].mean(axis=1) - [15.0, 10.0, 20.0]).max(axis=1) < 8.0


def apart(mesh=MESH, own=MIDDLE, shift=0.0):
    """Nodes and tets of a mesh whose tets `own` have nodes of their own, moved by `shift` mm."""
    used, tets = np.unique(mesh.tets[own], return_inverse=True)
    cells = mesh.tets.copy()
    cells[own] = mesh.n_nodes + tets.reshape(-1, 4)
    left, cells = np.unique(cells, return_inverse=True)
    return np.vstack([mesh.nodes, mesh.nodes[used] + shift])[left], cells.reshape(-1, 4)


def write(path, nodes, tets, fixed=None):
    fixed = (nodes[:, 2] == 0) * 1 if fixed is None else fixed
    return write_grid(path, nodes, [("tetra", tets)], {"fixed": fixed, "displacement": 0.01 * nodes})


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
@pytest.mark.parametrize("shift", [0.0, 1e-6])
def test_a_region_with_nodes_of_its_own_is_joined_and_told(tmp_path, suffix, shift):
    nodes, tets = apart(shift=shift)
    path = write(tmp_path / f"b.{suffix}", nodes, tets)
    with pytest.warns(UserWarning, match=rf"{len(nodes) - MESH.n_nodes} nodes lay .* \(whole faces coincide there\)"):
        mesh = tr.read_mesh(path)
    assert (mesh.n_nodes, len(mesh.surface)) == (MESH.n_nodes, len(MESH.surface))
    assert np.allclose(mesh.nodes[mesh.tets], nodes[tets], atol=2e-6)
    # The same export's displacement fits the mesh that was read.
    assert np.allclose(read_displacement(path, mesh), 0.01 * mesh.nodes, atol=1e-6)


def test_an_archive_is_looked_at_too(tmp_path):
    nodes, tets = apart()
    np.savez(tmp_path / "b.npz", nodes_mm=nodes, tets=tets, fixed_nodes=np.flatnonzero(nodes[:, 2] == 0))
    with pytest.warns(UserWarning, match="whole faces coincide"):
        assert tr.read_mesh(tmp_path / "b.npz").n_nodes == MESH.n_nodes


def test_a_crack_that_is_meant_is_kept(tmp_path):
    right = MESH.nodes[MESH.tets].mean(axis=1)[:, 0] > 15.0
    nodes, tets = apart(own=right & (MESH.nodes[MESH.tets].mean(axis=1)[:, 2] > 16.0))
    path = write(tmp_path / "b.vtu", nodes, tets)
    with pytest.warns(UserWarning, match="whole faces coincide"):
        assert tr.read_mesh(path).n_nodes == MESH.n_nodes
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "the body has|.*parts that share no node")
        assert tr.read_mesh(path, coincident="keep").n_nodes == len(nodes)


def test_nodes_without_a_whole_face_in_common_are_told_and_joined_on_demand(tmp_path):
    # The block beside itself, turned by half a turn: the common face is cut along other diagonals.
    nodes, tets = kuhn([np.linspace(0.0, length, 3) for length in (30.0, 20.0, 40.0)])
    both = np.vstack([nodes, nodes * (-1.0, -1.0, 1.0) + (0.0, 20.0, 0.0)])
    path = write(tmp_path / "b.vtu", both, np.vstack([tets, tets + len(nodes)]))
    with (
        pytest.warns(UserWarning, match="2 parts that share no node, of 48, 48 tetrahedra"),
        pytest.warns(UserWarning, match="9 nodes lie where another node is, but share no whole face"),
    ):
        assert tr.read_mesh(path).n_nodes == len(both)
    with pytest.warns(UserWarning, match=r"joined with it \(as asked\)"):
        assert tr.read_mesh(path, coincident="join").n_nodes == len(both) - 9
    with pytest.raises(MeshError, match="one of certain, join, keep"):
        tr.read_mesh(path, coincident="maybe")


@pytest.mark.parametrize("held", ["sure", "perhaps", "free"])
def test_no_part_of_several_may_be_loose(held):
    nodes, tets = apart(shift=1e-2)
    mesh = tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(nodes[:, 2] == 0)})
    with pytest.raises(SupportError, match="2 parts that share no node, and nothing holds"):
        tr.Body(mesh, held=held)


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "npz"])
def test_a_mesh_of_left_handed_tets_alone_is_turned_and_told(tmp_path, suffix):
    left = MESH.tets[:, [1, 0, 2, 3]]
    path = tmp_path / f"b.{suffix}"
    if suffix == "npz":
        np.savez(path, nodes_mm=MESH.nodes, tets=left)
    else:
        write_grid(path, MESH.nodes, [("tetra", left)])
    with pytest.warns(UserWarning, match=f"all {MESH.n_tets} tetrahedra were left-handed"):
        assert np.allclose(tr.read_mesh(path).volumes, MESH.volumes)


def test_arrays_of_left_handed_tets_are_turned_too():
    given = (MESH.nodes, MESH.tets[:, [1, 0, 2, 3]], MESH.fixed_nodes)
    with pytest.warns(UserWarning, match="left-handed"):
        assert np.allclose(tr.Body(given).mesh.volumes, MESH.volumes)


def test_some_inverted_tets_among_many_stay_refused(tmp_path):
    tets = MESH.tets.copy()
    tets[:-1] = tets[:-1, [1, 0, 2, 3]]
    with pytest.raises(MeshError, match="inverted"):
        tr.read_mesh(write(tmp_path / "b.vtu", MESH.nodes, tets))


def test_two_copies_of_a_body_are_refused(tmp_path):
    nodes, tets = np.vstack([MESH.nodes] * 2), np.vstack([MESH.tets, MESH.tets + MESH.n_nodes])
    with (
        pytest.warns(UserWarning, match="whole faces coincide"),
        pytest.raises(MeshError, match="belongs to 4 tetrahedra"),
    ):
        tr.read_mesh(write(tmp_path / "b.vtu", nodes, tets))


@pytest.mark.parametrize("held", ["sure", "perhaps"])
def test_a_body_whose_whole_surface_is_held_is_refused(held):
    mesh = MESH.with_node_set("fixed", MESH.surface_nodes)
    with pytest.raises(MeshError, match="every boundary triangle is held"):
        tr.Body(mesh, held=held)
    assert tr.Body(mesh, held="free").mesh is mesh


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (
            0.16,
            "extent 6.4: looks like centimetres; .* by 10, or if they are inches multiply them by 25.4. A body is ",
        ),
        (0.4, "extent 16: looks like centimetres"),
        (20.0, "extent 800: check its unit. A body is rarely"),
    ],
)
def test_an_unlikely_extent_is_told_with_the_unit_that_would_be_likely(tmp_path, scale, words):
    path = write(tmp_path / "b.vtu", scale * MESH.nodes, MESH.tets)
    with pytest.warns(UnitWarning, match=words):
        assert tr.read_mesh(path).extent == pytest.approx(40.0 * scale)


@pytest.mark.parametrize(
    ("scale", "words"), [(0.001, "looks like metres; multiply its lengths by 1000"), (1e3, "neither of mm, cm, m")]
)
def test_an_extent_that_no_body_has_is_refused(tmp_path, scale, words):
    with pytest.raises(UnitError, match=words):
        tr.read_mesh(write(tmp_path / "b.vtu", scale * MESH.nodes, MESH.tets))


def test_nodes_a_hundredth_of_a_mm_apart_are_not_at_one_place(tmp_path):
    with pytest.warns(UserWarning, match="2 parts that share no node"):
        assert tr.read_mesh(write(tmp_path / "b.vtu", *apart(shift=0.01))).n_nodes > MESH.n_nodes
