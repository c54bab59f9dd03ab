"""Other shapes of a body and its patches: what they move, how everything measured follows them, what they explain."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rigs import rig
from tissuereg.diagnose import predictor
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.nuisances import make_nuisances
from tissuereg.diagnose.shape import HEIGHT_SHARE, PLACE_SHARE, SIZE_SHARE, shape_directions
from tissuereg.diagnose.signals import Layout
from tissuereg.effects import Relaxation
from tissuereg.simulate.fine.rims import sharp_nodes


def bulged(mesh, height=3.0):
    """Return a block whose top is a smooth hill, in flat facets."""
    nodes, size = mesh.nodes.copy(), mesh.nodes.max(axis=0)
    x, y, z = (nodes / size).T
    nodes[:, 2] += height * z * np.sin(np.pi * x) * np.sin(np.pi * y)
    return tr.Mesh(nodes, mesh.tets, mesh.node_sets)


def hill():
    """Return the rig on a body with a curved top."""
    believed = rig()
    mesh = bulged(believed.mesh)
    return replace(believed, mesh=mesh)


def named(experiment):
    """Return the directions of an experiment by name."""
    return {direction.name: direction for direction in shape_directions(experiment)}


@pytest.mark.parametrize("name", ["place of top 0", "size of side", "height of side", "tilt of top 1", "surface 0"])
def test_derivatives_by_the_shape_are_those_of_bodies_that_are_solved_anew(name, monkeypatch):
    monkeypatch.setattr(predictor, "TOLERANCE", 1e-10)
    believed = hill()
    layout = Layout(believed)
    motion = named(believed)[name].motion
    found = Bench(believed, layout).by_shapes([motion])[0]
    ends = []
    # To one side: a marker at the edge of two facets moves with either.
    for step in (1e-4, 0.0):
        mesh = tr.Mesh(believed.mesh.nodes + step * motion, believed.mesh.tets, believed.mesh.node_sets)
        ends.append(predictor.Predictor(replace(believed, mesh=mesh), layout).predict())
    expected = (ends[0] - ends[1]) / 1e-4
    for of in (layout.of_markers(), ~layout.of_markers()):
        assert np.linalg.norm(expected[of]) > 1e-3
        assert np.linalg.norm((found - expected)[of]) < 0.01 * np.linalg.norm(expected[of])


def test_a_pad_that_pulls_does_so_by_the_same_force_whatever_its_size():
    believed = hill()
    top = replace(believed.actuator("top"), kind="force")
    down = believed.cases["down"]
    given = {"top": 30.0 * down.displacements["top"]}
    pulled = replace(down, displacements={}, forces={}, applied_forces=given)
    believed = replace(believed, actuators=(top, believed.actuators[1]), cases={**believed.cases, "down": pulled})
    layout = Layout(believed)
    motion = named(believed)["size of top"].motion
    found = Bench(believed, layout).by_shapes([motion])[0]
    ends = []
    for step in (1e-2, -1e-2):
        mesh = tr.Mesh(believed.mesh.nodes + step * motion, believed.mesh.tets, believed.mesh.node_sets)
        ends.append(predictor.Predictor(replace(believed, mesh=mesh), layout).predict())
    expected = (ends[0] - ends[1]) / 2e-2
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


def test_a_body_that_remembers_follows_its_shape_as_its_elastic_twin_does():
    believed = hill()
    motion = named(believed)["size of top"].motion
    elastic = Bench(believed, Layout(believed)).by_shapes([motion])
    remembers = replace(believed, effects=(Relaxation(g=(0.3,), tau_s=(1.0,)),))
    np.testing.assert_allclose(Bench(remembers, Layout(remembers)).by_shapes([motion]), elastic)


def test_patches_slide_along_the_surface_and_edges_of_the_body_stay():
    believed = hill()
    mesh, directions = believed.mesh, named(believed)
    sharp = sharp_nodes(mesh.nodes, mesh.surface)
    for pad in believed.actuators:
        for name in (f"place of {pad.name} 0", f"place of {pad.name} 1", f"size of {pad.name}"):
            motion = directions[name].motion
            assert not motion[sharp].any()
            # To first order no tet at the surface gains volume.
            swept = _swept_volume(mesh, motion)
            assert abs(swept) < 0.02 * _swept_volume(mesh, directions[f"height of {pad.name}"].motion)
        assert directions[f"height of {pad.name}"].motion[np.setdiff1d(pad.nodes, sharp)].any(axis=1).all()
    fixed = believed.boundaries[0].nodes
    assert not any(direction.motion[fixed].any() for direction in directions.values())


def test_the_edge_of_a_support_within_a_face_moves_outwards():
    believed = rig()
    size = believed.mesh.nodes.max(axis=0)
    middle = believed.mesh.surface_nodes[
        (believed.mesh.nodes[believed.mesh.surface_nodes, 2] == 0.0)
        & (np.abs(believed.mesh.nodes[believed.mesh.surface_nodes, :2] - 0.5 * size[:2]) < 0.4 * size[:2]).all(axis=1)
    ]
    support = replace(believed.boundaries[0], nodes=middle, edge_std=0.7)
    believed = replace(believed, boundaries=(support,))
    (edge,) = [direction for direction in shape_directions(believed) if direction.name == "edge of base"]
    assert edge.std_mm == 0.7
    arms = believed.mesh.nodes - believed.mesh.nodes[middle].mean(axis=0)
    moved = edge.motion.any(axis=1)
    assert moved.any()
    assert ((edge.motion * arms).sum(axis=1)[moved] > 0.0).all()
    np.testing.assert_allclose(edge.motion[moved][:, 2], 0.0, atol=1e-12)


def test_stated_deviations_are_taken_and_others_follow_size_and_facets():
    believed = hill()
    top, side = believed.actuators
    stated = replace(believed, actuators=(replace(top, edge_std=0.9), side))
    assert {named(stated)[f"place of top {i}"].std_mm for i in (0, 1)} == {0.9}
    assert named(stated)["size of top"].std_mm == 0.9
    own = named(believed)["place of side 0"].std_mm
    whole, touched = (PLACE_SHARE * np.sqrt(_area(believed.mesh, side.nodes, of) / np.pi) for of in (np.all, np.any))
    assert whole < own < touched
    # Flat sides have no facets that lie off them.
    flat = named(rig())
    for name, share in (("height", HEIGHT_SHARE), ("size", SIZE_SHARE)):
        assert flat[f"{name} of side"].std_mm == pytest.approx(share / PLACE_SHARE * own)
    assert not any(name.startswith(("facets", "surface")) for name in flat)
    assert named(believed)["height of top"].std_mm > named(rig())["height of top"].std_mm


def test_a_surface_that_was_segmented_is_off_by_what_is_stated():
    believed = replace(rig(), surface_std=0.8, surface_length=10.0)
    patterns = [direction for name, direction in named(believed).items() if name.startswith("surface")]
    assert {direction.std_mm for direction in patterns} == {0.8}
    mesh = believed.mesh
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    variance = sum((direction.motion**2).sum(axis=1) for direction in patterns)
    assert 0.85 < variance[free].mean() <= 1.0 + 1e-9
    # Longer lengths need fewer patterns.
    longer = replace(believed, surface_length=40.0)
    assert sum(name.startswith("surface") for name in named(longer)) < len(patterns)


def test_nuisances_hold_every_direction_times_its_deviation():
    believed = hill()
    layout = Layout(believed)
    bench = Bench(believed, layout)
    nuisances = make_nuisances(bench, np.zeros((0, layout.size)))
    directions = shape_directions(believed)
    columns = bench.by_shapes([direction.motion for direction in directions])
    for direction, column in zip(directions, columns, strict=True):
        (mine,) = np.flatnonzero([name == direction.name for name in nuisances.names])
        np.testing.assert_allclose(nuisances.columns[mine], direction.std_mm * column)


def _swept_volume(mesh, motion):
    corners = mesh.nodes[mesh.surface]
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.abs((normals * motion[mesh.surface].mean(axis=1)).sum(axis=1).sum()))


def _area(mesh, nodes, of):
    corners = mesh.nodes[mesh.surface[of(np.isin(mesh.surface, nodes), axis=1)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normals, axis=1).sum())
