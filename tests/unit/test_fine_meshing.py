"""Meshes cut at edges and along the rims of pads, and their node sets."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import write_experiment
from support.meshes import block
from tissuereg.errors import MeshError
from tissuereg.simulation.fine import FineMeshing, bisection, fine_experiment, third_meshes
from tissuereg.simulation.fine import rims as rims_module
from tissuereg.simulation.fine.bisection import Bisection, shape_quality
from tissuereg.simulation.fine.rims import Rim, cut_along, patch_nodes, rim_nodes
from tissuereg.simulation.fine.third import gaps, jittered


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A block of 30 x 20 x 40 mm held at z = 0; its pad, a ball of 8 mm, overlaps an edge of the top."""
    return tr.read_experiment(write_experiment(tmp_path_factory.mktemp("fine") / "rig"))


def face_counts(tets):
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    return np.unique(faces, axis=0, return_counts=True)


def assert_sound(mesh, like):
    """Tets positive, the same volume and surface area; each face has two tets, or one and lies on the boundary."""
    assert (mesh.volumes > 0).all()
    assert mesh.volumes.sum() == pytest.approx(like.volumes.sum(), rel=1e-12)
    faces, count = face_counts(mesh.tets)
    assert set(count) == {1, 2}
    outer = mesh.nodes[faces[count == 1]]
    area = np.linalg.norm(np.cross(outer[:, 1] - outer[:, 0], outer[:, 2] - outer[:, 0]), axis=1).sum() / 2
    corners = like.nodes[like.surface]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert area == pytest.approx(np.linalg.norm(normal, axis=1).sum() / 2, rel=1e-12)


def test_edges_of_one_tet_are_cut_one_after_another_and_the_mesh_fits_together(block_mesh):
    cutter = Bisection(block_mesh)
    edges = cutter.surface_edges()[::3]
    new = cutter.cut(edges, block_mesh.nodes[edges].mean(axis=1))
    mesh = cutter.mesh(block_mesh.node_sets)
    np.testing.assert_array_equal(mesh.nodes[new], block_mesh.nodes[edges].mean(axis=1))
    np.testing.assert_array_equal(np.sort(cutter.parents[new], axis=1), edges)
    assert_sound(mesh, block_mesh)
    np.testing.assert_array_equal(np.unique(cutter.surface), mesh.surface_nodes)
    np.testing.assert_array_equal(np.flatnonzero(cutter.on_surface), mesh.surface_nodes)


def test_refinement_ends_where_all_edges_are_short_enough_and_keeps_shapes(block_mesh):
    cutter = Bisection(block_mesh)
    cutter.refine(lambda centres: np.where(centres[:, 2] > 30.0, 4.0, 1000.0))
    mesh = cutter.mesh(block_mesh.node_sets)
    assert_sound(mesh, block_mesh)
    ends = mesh.nodes[mesh.edges]
    high = ends[..., 2].min(axis=1) > 32.0
    assert np.linalg.norm(ends[high, 0] - ends[high, 1], axis=1).max() <= 4.0
    assert shape_quality(mesh.nodes, mesh.tets).min() > 0.4 * shape_quality(block_mesh.nodes, block_mesh.tets).min()
    # Far from there the mesh is the old one.
    assert (mesh.nodes[:, 2] < 10.0).sum() == (block_mesh.nodes[:, 2] < 10.0).sum()


def test_refinement_to_nothing_is_refused(block_mesh, monkeypatch):
    monkeypatch.setattr(bisection, "FINE", replace(bisection.FINE, most_rounds=3))
    with pytest.raises(MeshError, match="refinement must end within 3 rounds"):
        Bisection(block_mesh).refine(lambda centres: np.full(len(centres), 1.0))


def test_sets_are_carried_over_to_the_nodes_between_their_nodes(rig):
    fine = fine_experiment(rig, FineMeshing(edge_share=0.2)).mesh
    np.testing.assert_array_equal(fine.fixed_nodes, np.flatnonzero(fine.nodes[:, 2] == 0.0))
    np.testing.assert_array_equal(fine.node_set("base"), fine.fixed_nodes)


@pytest.mark.parametrize("snap", [0.0, rims_module.FINE.snap_share])
@pytest.mark.parametrize("radius", [2.0, 5.5, 8.0])
def test_a_pad_ends_at_its_rim(rig, monkeypatch, snap, radius):
    monkeypatch.setattr(rims_module, "FINE", replace(rims_module.FINE, snap_share=snap))
    ball = {"centre_mm": [17.0, 10.0, 40.0], "radius_mm": radius}
    pad = replace(rig.actuators[0], rule=ball)
    fine = fine_experiment(replace(rig, actuators=(pad,)))
    mesh, nodes = fine.mesh, fine.actuators[0].nodes
    # Slides go along a flat face here, so they keep the volume too.
    assert_sound(mesh, rig.mesh)
    assert shape_quality(mesh.nodes, mesh.tets).min() > (0.01 if snap == 0.0 else 0.1)
    depth = radius - np.linalg.norm(mesh.nodes - ball["centre_mm"], axis=1)
    assert depth[nodes].min() >= 0.0
    np.testing.assert_array_equal(nodes, mesh.surface_nodes_within(ball["centre_mm"], radius))
    np.testing.assert_array_equal(nodes, mesh.node_set("push"))
    # No triangle is cut by the rim: its nodes are all in the patch, or none lies deeper than the rim.
    inside = np.isin(mesh.surface, nodes).all(axis=1)
    assert depth[mesh.surface[~inside]].max() < 1e-9
    corners = mesh.nodes[mesh.surface[inside]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(np.pi * radius**2, rel=0.03)


def test_a_coarse_disc_lacks_what_its_polygon_lacks(block_mesh):
    rim, cutter = Rim((15.0, 10.0, 40.0), 8.0), Bisection(block_mesh)
    cut_along(cutter, rim, np.empty(0, np.int64))
    on_rim = cutter.nodes[rim_nodes(cutter, rim)]
    angles = np.sort(np.arctan2(on_rim[:, 1] - 10.0, on_rim[:, 0] - 15.0))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    patch = cutter.surface[np.isin(cutter.surface, patch_nodes(cutter, rim)).all(axis=1)]
    corners = cutter.nodes[patch]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(32.0 * np.sin(gaps).sum(), rel=1e-9)


def test_a_pad_over_an_edge_of_the_body_is_cut_on_both_faces(rig):
    fine = fine_experiment(rig)
    assert_sound(fine.mesh, rig.mesh)
    nodes = fine.mesh.nodes[fine.actuators[0].nodes]
    assert (nodes[:, 2] < 40.0).any()
    assert (nodes[:, 0] < 30.0).any()
    # The edges of the block are still there.
    np.testing.assert_array_equal(fine.mesh.nodes.min(axis=0), rig.mesh.nodes.min(axis=0))
    np.testing.assert_array_equal(fine.mesh.nodes.max(axis=0), rig.mesh.nodes.max(axis=0))


def test_two_pads_that_overlap_both_end_near_their_rims(rig):
    first = {"centre_mm": [12.0, 10.0, 40.0], "radius_mm": 6.0}
    second = {"centre_mm": [20.0, 10.0, 40.0], "radius_mm": 6.0}
    pads = (replace(rig.actuators[0], rule=first), replace(rig.actuators[0], name="other", rule=second))
    fine = fine_experiment(replace(rig, actuators=pads))
    assert_sound(fine.mesh, rig.mesh)
    for pad, ball in zip(fine.actuators, (first, second), strict=True):
        depth = 6.0 - np.linalg.norm(fine.mesh.nodes - ball["centre_mm"], axis=1)
        outside = ~np.isin(fine.mesh.surface, pad.nodes).all(axis=1)
        # Where the second cut meets an edge that ends on the first rim, it may do so a little inside that.
        assert depth[fine.mesh.surface[outside]].max() < 0.05


def test_a_pad_given_by_its_nodes_keeps_its_outline(rig):
    nodes = np.flatnonzero((rig.mesh.nodes[:, 2] == 40.0) & (rig.mesh.nodes[:, 0] <= 15.0))
    mesh = rig.mesh.with_node_set("push", nodes)
    pad = replace(rig.actuators[0], nodes=nodes, rule="push")
    fine = fine_experiment(replace(rig, mesh=mesh, actuators=(pad,)), FineMeshing(rim_edge=0.3))
    assert_sound(fine.mesh, rig.mesh)
    wanted = np.flatnonzero((fine.mesh.nodes[:, 2] == 40.0) & (fine.mesh.nodes[:, 0] <= 15.0))
    np.testing.assert_array_equal(fine.actuators[0].nodes, wanted)
    assert len(wanted) > len(nodes)


def test_third_meshes_differ_and_are_the_same_for_a_seed(rig):
    two, again = third_meshes(rig, 2, seed=5), third_meshes(rig, 1, seed=5)
    assert two[0].mesh.digest() == again[0].mesh.digest() != two[1].mesh.digest()
    for model in two:
        # Slides stay on flat faces here; nodes on edges of the block stay.
        assert_sound(model.mesh, rig.mesh)


def test_jitter_leaves_half_of_every_quality_and_all_that_is_held(rig):
    mesh = jittered(rig, np.random.default_rng(2))
    moved = np.linalg.norm(mesh.nodes - rig.mesh.nodes, axis=1)
    assert moved[rig.mesh.fixed_nodes].max() == 0.0
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.surface_nodes)
    assert (moved[inner] > 0.0).all()
    assert moved.max() <= 0.25 * np.linalg.norm(np.diff(mesh.nodes[mesh.edges], axis=1), axis=2).max()
    before, after = (shape_quality(m.nodes, m.tets) for m in (rig.mesh, mesh))
    assert (after >= 0.5 * before).all()


def test_facets_of_a_curved_surface_lie_below_it_by_the_gap():
    mesh = block((30.0, 30.0, 20.0), (10, 10, 4))
    # The top becomes a part of a sphere of 60 mm.
    x, y, z = mesh.nodes.T
    rise = np.sqrt(60.0**2 - (x - 15.0) ** 2 - (y - 15.0) ** 2) - 55.0
    dome = tr.Mesh(np.stack([x, y, z * (1.0 + rise / 20.0)], axis=1), mesh.tets)
    inner = np.flatnonzero((z == 20.0) & (np.abs(x - 15.0) < 9.1) & (np.abs(y - 15.0) < 9.1))
    found = gaps(dome)
    centre = np.array([15.0, 15.0, -35.0])
    outwards = (dome.nodes[inner] - centre) / 60.0
    size = np.linalg.norm(found[inner], axis=1)
    np.testing.assert_allclose((found[inner] * outwards).sum(axis=1), size, rtol=0.01)
    # Not exact: the triangles have right angles.
    points = dome.nodes[dome.surface]
    top = np.isin(dome.surface, inner).all(axis=1)
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 4000)
    below = 60.0 - np.linalg.norm(np.einsum("pc,tcx->ptx", weights, points[top]) - centre, axis=2)
    assert size.mean() == pytest.approx(below.mean(), rel=0.5)
    flat = gaps(mesh)
    assert np.abs(flat).max() < 1e-12
