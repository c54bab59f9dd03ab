"""Shape nuisances: motions of the mesh, their sensitivity columns, and what they explain."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rigs import rig
from tissuereg.diagnosis import bench as bench_module
from tissuereg.diagnosis import predictor, shape
from tissuereg.diagnosis.bench import Bench, Tangents
from tissuereg.diagnosis.correction import make_correction
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.nuisances import make_nuisances
from tissuereg.diagnosis.refined import flat_of
from tissuereg.diagnosis.run import make_believed
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.shape import shape_columns, shape_directions, shape_nuisances
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Relaxation
from tissuereg.experiment.experiment import Actuator
from tissuereg.simulation.experiment import believed_case
from tissuereg.simulation.fine.elastic import solve_states
from tissuereg.simulation.fine.reading import Reader
from tissuereg.simulation.fine.rims import sharp_nodes
from tissuereg.simulation.settings import SIZE


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
    # No marker lies on an edge of two facets: there derivatives differ from side to side.
    off = np.random.default_rng(3).uniform(0.1, 0.6, believed.marker_reference.shape)
    return replace(believed, mesh=mesh, marker_reference=believed.marker_reference + off)


def named(experiment, settings=DEFAULT.shape):
    """Return the directions of an experiment by name."""
    return {direction.name: direction for direction in shape_directions(experiment, settings=settings)}


@pytest.mark.parametrize("name", ["place of top 0", "size of side", "height of side", "tilt of top 1", "surface 0"])
def test_derivatives_by_the_shape_are_those_of_bodies_that_are_solved_anew(name):
    sharp = replace(DEFAULT.model, tolerance=1e-10)
    believed = hill()
    layout = SignalLayout(believed)
    motion = named(believed)[name].motion
    found = Tangents(predictor.Predictor(believed, layout, settings=sharp)).by_shapes([motion])[0]
    ends = []
    for step in (1e-4, -1e-4):
        mesh = tr.Mesh(believed.mesh.nodes + step * motion, believed.mesh.tets, believed.mesh.node_sets)
        ends.append(predictor.Predictor(replace(believed, mesh=mesh), layout, settings=sharp).predict())
    expected = (ends[0] - ends[1]) / 2e-4
    for of in (layout.of_markers(), ~layout.of_markers()):
        assert np.linalg.norm(expected[of]) > 1e-3
        assert np.linalg.norm((found - expected)[of]) < 0.01 * np.linalg.norm(expected[of])


@pytest.mark.parametrize("keep", [True, False])
def test_tangents_are_factored_once_a_state_however_many_are_kept(monkeypatch, keep):
    believed, made = hill(), []

    class Counted(bench_module.Linearised):
        def __init__(self, *given, **how):
            made.append(1)
            super().__init__(*given, **how)

    monkeypatch.setattr(bench_module, "Linearised", Counted)
    motion = named(believed)["size of side"].motion
    found = Tangents(predictor.Predictor(believed, SignalLayout(believed)), keep=keep)
    first = found.by_shapes([motion])
    assert len(made) == len(found.states) > 1
    assert np.array_equal(found.by_shapes([motion]), first)
    # The last of the first pass is not the first of the second.
    assert len(made) == len(found.states) * (1 if keep else 2)


def test_the_simulators_of_supports_that_were_tried_do_not_add_up():
    believed, kept = rig(), {}
    mesh = believed.mesh
    for number in range(SIZE.rigs_kept + 3):
        loose = tr.Mesh(mesh.nodes, mesh.tets, {**mesh.node_sets, "fixed": mesh.fixed_nodes[number:]})
        tried = replace(believed, mesh=loose)
        found = believed_case(tried, tried.cases["down"], simulators=kept)
        assert next(reversed(kept.values())) is found.simulator
    assert len(kept) == SIZE.rigs_kept
    assert believed_case(tried, tried.cases["down"], simulators=kept).simulator is found.simulator
    # The least recently used one goes, not the one that was made first.
    first, second = list(kept)[:2]
    pads = np.concatenate([pad.nodes for pad in believed.actuators])
    held = np.setdiff1d(np.frombuffer(first[1], np.int64), pads)
    kept[first].mesh = tr.Mesh(mesh.nodes, mesh.tets, {**mesh.node_sets, "fixed": held})
    again = replace(believed, mesh=kept[first].mesh)
    assert believed_case(again, again.cases["down"], simulators=kept).simulator is kept[first]
    loose = tr.Mesh(mesh.nodes, mesh.tets, {**mesh.node_sets, "fixed": mesh.fixed_nodes[:4]})
    believed_case(replace(believed, mesh=loose), believed.cases["down"], simulators=kept)
    assert first in kept
    assert second not in kept


def test_a_marker_on_an_edge_of_the_mesh_has_one_derivative_whichever_way_the_shape_goes():
    believed = rig()
    mesh = believed.mesh
    triangle = mesh.surface[5]
    out = np.cross(*(mesh.nodes[triangle[1:]] - mesh.nodes[triangle[0]]))
    # Off the surface it turns with the patch of its triangle, which a step to one side would exchange.
    place = mesh.nodes[triangle[:2]].mean(axis=0) + 0.5 * out / np.linalg.norm(out)
    moved = replace(believed, marker_reference=np.concatenate([place[None], believed.marker_reference[1:]]))
    motion = np.random.default_rng(0).normal(size=mesh.nodes.shape)
    by = Tangents(predictor.Predictor(moved, SignalLayout(moved)))
    one, other = (SignalLayout(moved)["down"].markers(found) for found in by.by_shapes([motion, -motion]))
    np.testing.assert_allclose(one[:, 0], -other[:, 0], atol=1e-3 * np.abs(one[:, 0]).max())


def test_a_pad_that_pulls_does_so_by_the_same_force_whatever_its_size():
    believed = hill()
    top = replace(believed.actuator("top"), kind="force")
    down = believed.cases["down"]
    given = {"top": 30.0 * down.displacements["top"]}
    pulled = replace(down, displacements={}, forces={}, applied_forces=given)
    believed = replace(believed, actuators=(top, believed.actuators[1]), cases={**believed.cases, "down": pulled})
    layout = SignalLayout(believed)
    motion = named(believed)["size of top"].motion
    found = Tangents(predictor.Predictor(believed, layout)).by_shapes([motion])[0]
    ends = []
    for step in (1e-2, -1e-2):
        mesh = tr.Mesh(believed.mesh.nodes + step * motion, believed.mesh.tets, believed.mesh.node_sets)
        ends.append(predictor.Predictor(replace(believed, mesh=mesh), layout).predict())
    expected = (ends[0] - ends[1]) / 2e-2
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


def test_shape_columns_of_a_body_with_memory_are_those_of_its_elastic_counterpart():
    believed = hill()
    remembers = replace(believed, effects=(Relaxation(g=(0.3,), tau_s=(1.0,)),))
    benches = [Bench(one, SignalLayout(one)) for one in (believed, remembers)]
    elastic, slow = (dict(shape_columns(bench, benches[0].base)) for bench in benches)
    assert len(elastic) == len(slow)
    for one, other in zip(elastic.values(), slow.values(), strict=True):
        np.testing.assert_allclose(one, other)


def disc():
    """Return the hill with one pad in a ball, in the middle of its top, and a marker near the pad's rim."""
    believed = hill()
    size = believed.mesh.nodes.max(axis=0)
    centre = np.array([0.5 * size[0], 0.5 * size[1], size[2]])
    rule = {"centre_mm": tuple(centre), "radius_mm": 7.0}
    nodes = believed.mesh.surface_nodes
    inside = nodes[np.linalg.norm(believed.mesh.nodes[nodes] - centre, axis=1) <= 7.0]
    pad = Actuator("top", inside, "displacement", rule=rule)
    reference = believed.marker_reference.copy()
    reference[0] = centre + np.array([8.5, 0.3, -0.6])
    down = believed.cases["down"]
    cases = {name: case for name, case in believed.cases.items() if name != "in"} | {"down": down}
    return replace(believed, actuators=(pad,), marker_reference=reference, cases=cases)


def test_a_derivative_by_a_pads_place_or_height_is_that_of_the_fine_model():
    believed = disc()
    layout = SignalLayout(believed)
    bench = Bench(believed, layout)
    fine = flat_of(layout, bench.fine.simulate())
    columns = {direction.name: column for direction, column in shape_columns(bench, fine)}
    rough = dict(zip(named(believed), _on_the_users_mesh(believed, layout, fine), strict=True))
    motions = {one.name: one.motion for one in shape_directions(bench.fine.fine, believed.mesh)}
    markers = layout.of_markers()
    for name in ("place of top 0", "place of top 1", "height of top", "size of top"):
        moved = _FineWith(bench.fine, motions[name])
        expected = (moved.at(layout, 2e-2) - moved.at(layout, -2e-2)) / 4e-2
        off = np.linalg.norm((columns[name] - expected)[markers]) / np.linalg.norm(expected[markers])
        before = np.linalg.norm((rough[name] - expected)[markers]) / np.linalg.norm(expected[markers])
        assert off < 0.35, name
        assert off < before, name
    # Forces are those of ten-node elements.
    size = np.linalg.norm(expected[~markers])
    assert np.linalg.norm((columns[name] - expected)[~markers]) < 0.25 * size


def test_forces_of_a_derivative_are_carried_into_those_of_the_fine_answer_and_markers_are_not():
    believed = disc()
    layout = SignalLayout(believed)
    bench = Bench(believed, layout)
    markers = layout.of_markers()
    fine = flat_of(layout, bench.fine.simulate())
    softer = np.where(markers, fine, 0.8 * fine)
    for (direction, column), (_, other) in zip(shape_columns(bench, fine), shape_columns(bench, softer), strict=True):
        np.testing.assert_allclose(other[~markers], 0.8 * column[~markers], err_msg=direction.name)
        np.testing.assert_allclose(other[markers], column[markers])


class _FineWith:
    """The fine model of an experiment with its mesh moved."""

    def __init__(self, model, motion):
        self.model, self.motion = model, motion

    def at(self, layout, step):
        fine, case = self.model.fine, self.model.fine.cases["down"]
        mesh = tr.Mesh(fine.mesh.nodes + step * self.motion, fine.mesh.tets, fine.mesh.node_sets)
        moved = replace(fine, mesh=mesh)
        solved = solve_states(moved, case, tolerance=1e-8)
        said = Reader(moved, mesh, quadratic=True).read(solved)
        flat = np.zeros(layout.size)
        layout["down"].markers(flat)[:] = said.markers
        layout["down"].forces(flat)[:, 0] = said.forces["top"]
        return flat


def _on_the_users_mesh(believed, layout, fine):
    motions = [direction.motion for direction in shape_directions(believed)]
    bench = Bench(believed, layout)
    return make_correction(layout, bench.base, fine).of_columns(bench.tangents.by_shapes(motions))


def test_facets_that_a_fine_mesh_subdivides_keep_their_gap_to_the_smooth_surface():
    believed = disc()
    fine = Bench(believed, SignalLayout(believed)).fine.fine
    whole, divided = named(believed), {one.name: one for one in shape_directions(fine, believed.mesh)}
    assert divided["facets"].std_mm == whole["facets"].std_mm
    kept = np.flatnonzero((fine.mesh.nodes[: believed.mesh.n_nodes] == believed.mesh.nodes).all(axis=1))
    np.testing.assert_allclose(divided["facets"].motion[kept], whole["facets"].motion[kept], atol=1e-9)
    added = np.setdiff1d(fine.mesh.surface_nodes, np.arange(believed.mesh.n_nodes))
    assert divided["facets"].motion[added].any(axis=1).mean() > 0.3
    # Taken for facets of its own they would lie nearer to it.
    assert {one.name: one for one in shape_directions(fine)}["facets"].std_mm < 0.7 * whole["facets"].std_mm
    bench = Bench(believed, SignalLayout(believed))
    taken = {direction.name: direction for direction, _ in shape_columns(bench, bench.base)}
    assert taken["facets"].std_mm == whole["facets"].std_mm


def test_patches_slide_along_the_surface_and_edges_of_the_body_stay():
    believed = hill()
    mesh, directions = believed.mesh, named(believed)
    sharp = sharp_nodes(mesh.nodes, mesh.surface)
    for pad in believed.actuators:
        waves = [f"rim of {pad.name} {times} {number}" for times in DEFAULT.shape.waves for number in (0, 1)]
        for name in (f"place of {pad.name} 0", f"place of {pad.name} 1", f"size of {pad.name}", *waves):
            motion = directions[name].motion
            assert not motion[sharp].any()
            # To first order no tet at the surface gains volume.
            swept = _swept_volume(mesh, motion)
            assert abs(swept) < 0.02 * _swept_volume(mesh, directions[f"height of {pad.name}"].motion)
        assert directions[f"height of {pad.name}"].motion[np.setdiff1d(pad.nodes, sharp)].any(axis=1).all()
    fixed = believed.boundaries[0].nodes
    assert not any(direction.motion[fixed].any() for direction in directions.values())


def test_a_rim_goes_out_and_in_as_often_as_it_says():
    believed = disc()
    (pad,) = believed.actuators
    fine = Bench(believed, SignalLayout(believed)).fine.fine
    directions = {one.name: one for one in shape_directions(fine, believed.mesh)}
    arms = fine.mesh.nodes - np.array(pad.rule["centre_mm"])
    near = np.abs(np.linalg.norm(arms, axis=1) - 7.0) < 1e-6
    assert near.sum() > 12
    angle = np.arctan2(arms[near, 1], arms[near, 0])
    out = {name: (one.motion[near, :2] * arms[near, :2]).sum(axis=1) / 7.0 for name, one in directions.items()}
    for times in DEFAULT.shape.waves:
        waves = np.array([out[f"rim of top {times} {number}"] for number in (0, 1)])
        # Both together are one wave, of any phase, as high as the patch grows.
        np.testing.assert_allclose(np.linalg.norm(waves, axis=0), out["size of top"], rtol=1e-6)
        turned = np.unwrap((np.arctan2(waves[1], waves[0]) / times)[np.argsort(angle)], period=2 * np.pi / times)
        # On a surface that is not quite flat.
        np.testing.assert_allclose(np.abs(np.diff(turned)), np.diff(np.sort(angle)), atol=1e-3)
    assert directions["rim of top 2 0"].std_mm == directions["place of top 0"].std_mm


def test_a_pad_that_grips_both_faces_slides_along_them_and_has_an_edge():
    believed = rig()
    mesh = believed.mesh
    faces = np.isin(mesh.nodes[:, 1], (0.0, mesh.nodes[:, 1].max()))
    both = np.flatnonzero(faces & (mesh.nodes[:, 0] > 0.5 * mesh.nodes[:, 0].max()) & (mesh.nodes[:, 2] > 10.0))
    both = np.setdiff1d(both, sharp_nodes(mesh.nodes, mesh.surface))
    pad = replace(believed.actuators[1], nodes=both, edge_std=0.8)
    directions = {name: one for name, one in named(replace(believed, actuators=(pad,))).items() if pad.name in name}
    assert set(directions) == {*(f"place of {pad.name} {axis}" for axis in range(3)), f"edge of {pad.name}"}
    assert {one.std_mm for one in directions.values()} == {0.8}
    assert all(one.motion[both].any() for name, one in directions.items() if name != f"place of {pad.name} 1")
    # No motion leads out of a face.
    assert max(np.abs(one.motion[both, 1]).max() for one in directions.values()) < 1e-12


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
    whole = replace(believed, boundaries=(replace(support, edge_std=None),))
    usual, exact = (
        next(one.std_mm for one in shape_directions(whole, settings=rules) if one.name == "edge of base")
        for rules in (DEFAULT.shape, replace(DEFAULT.shape, edge_share=0.0))
    )
    lengths = np.linalg.norm(np.diff(believed.mesh.nodes[believed.mesh.edges], axis=1)[:, 0], axis=1)
    share = np.sqrt(usual**2 - exact**2) / DEFAULT.shape.edge_share
    assert lengths.min() - 1e-9 <= share <= lengths.max() + 1e-9
    np.testing.assert_allclose(edge.motion[moved][:, 2], 0.0, atol=1e-12)


def test_stated_deviations_are_taken_and_others_follow_size_and_facets():
    believed = hill()
    top, side = believed.actuators
    stated = replace(believed, actuators=(replace(top, edge_std=0.9), side))
    assert {named(stated)[f"place of top {i}"].std_mm for i in (0, 1)} == {0.9}
    assert named(stated)["size of top"].std_mm == 0.9
    exact = replace(DEFAULT.shape, edge_share=0.0)
    own = named(believed, exact)["place of side 0"].std_mm
    whole, touched = (
        DEFAULT.shape.place_share * np.sqrt(_area(believed.mesh, side.nodes, of) / np.pi) for of in (np.all, np.any)
    )
    assert whole < own < touched
    # Flat sides have no facets that lie off them.
    flat = named(rig(), exact)
    for name, share in (("height", DEFAULT.shape.height_share), ("size", DEFAULT.shape.size_share)):
        assert flat[f"{name} of side"].std_mm == pytest.approx(share / DEFAULT.shape.place_share * own)
    assert not any(name.startswith(("facets", "surface")) for name in flat)
    assert named(believed)["height of top"].std_mm > named(rig())["height of top"].std_mm


def test_the_edge_of_a_patch_is_as_uncertain_as_the_mesh_is_coarse():
    believed, rules = rig(), DEFAULT.shape
    usual, exact = named(believed), named(believed, replace(rules, edge_share=0.0))

    def added(name):
        return np.sqrt(usual[name].std_mm ** 2 - exact[name].std_mm ** 2)

    edges = np.linalg.norm(np.diff(believed.mesh.nodes[believed.mesh.edges], axis=1)[:, 0], axis=1)
    assert rules.edge_share * edges.min() - 1e-9 <= added("size of side") <= rules.edge_share * edges.max() + 1e-9
    assert added("place of side 0") == pytest.approx(added("size of side"))
    assert added("rim of side 2 1") == pytest.approx(added("size of side"))
    assert usual["height of side"].std_mm == exact["height of side"].std_mm
    twice = replace(believed, mesh=tr.Mesh(2.0 * believed.mesh.nodes, believed.mesh.tets, believed.mesh.node_sets))
    assert named(twice)["size of side"].std_mm == pytest.approx(2.0 * usual["size of side"].std_mm)


def test_a_ball_is_as_large_as_the_nodes_in_it():
    # Discs around points between the nodes of a lattice: radius of a disc of the area of the nodes inside.
    rng, radius, h = np.random.default_rng(0), 9.0, 4.0
    steps = h * np.arange(-5, 6)
    off = []
    for x, y, r in rng.random((6000, 3)) * [h, h, 6.0] + [0.0, 0.0, radius - 3.0]:
        count = np.sum((steps[:, None] + x) ** 2 + (steps[None] + y) ** 2 < r**2)
        off.append((h * np.sqrt(count / np.pi) - r) * np.sqrt(r / radius))
    std = np.std(off)
    believed = rig()
    side = believed.actuators[1]
    x, y, z = believed.mesh.nodes[side.nodes].mean(axis=0)
    ball = replace(side, rule={"centre_mm": [x, y, z], "radius_mm": radius})
    given = named(replace(believed, actuators=(believed.actuators[0], ball)))["size of side"].std_mm
    plain = named(
        replace(believed, actuators=(believed.actuators[0], ball)), replace(DEFAULT.shape, lattice=0.0)
    )["size of side"].std_mm  # fmt: skip
    by_nodes = np.sqrt(
        named(believed)["size of side"].std_mm ** 2
        - named(believed, replace(DEFAULT.shape, edge_share=0.0))["size of side"].std_mm ** 2
    )
    length = by_nodes / DEFAULT.shape.edge_share
    # It goes with the power 3/2 of the distance of nodes, half that of the given mesh.
    assert np.sqrt(given**2 - plain**2) == pytest.approx(std * (length / DEFAULT.shape.finer / h) ** 1.5, rel=0.1)
    assert plain == pytest.approx(DEFAULT.shape.size_share * radius)


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
    layout = SignalLayout(believed)
    bench = Bench(believed, layout)
    correction = make_correction(layout, bench.base, np.where(layout.of_markers(), bench.base, 0.8 * bench.base))
    nuisances = make_nuisances(bench, np.zeros((0, layout.size)), correction)
    for direction, column in shape_columns(bench, correction.corrected(bench.base)):
        (mine,) = np.flatnonzero([name == direction.name for name in nuisances.names])
        np.testing.assert_allclose(nuisances.columns[mine], direction.std_mm * column)


def test_other_nuisances_are_carried_into_the_fine_mesh_too():
    believed = hill()
    layout = SignalLayout(believed)
    bench = Bench(believed, layout)
    correction = make_correction(layout, bench.base, np.where(layout.of_markers(), bench.base, 0.8 * bench.base))
    nuisances = make_nuisances(bench, np.zeros((0, layout.size)), correction)
    (column,) = nuisances.columns[[name == "stiffness" for name in nuisances.names]]
    scale = np.where(layout.of_markers(), 1.0, 0.8)
    np.testing.assert_allclose(column, scale * bench.young_spread * bench.by_young[0], atol=1e-9)


def test_nuisances_are_taken_at_the_fitted_modulus():
    believed = rig()
    said = tr.simulate_experiment(believed)
    cases = {
        name: replace(case, markers=said[name].markers, forces={pad: 1.4 * f for pad, f in said[name].forces.items()})
        for name, case in believed.cases.items()
    }
    believed = replace(believed, cases=cases)
    layout = SignalLayout(believed)
    bench, noise = Bench(believed, layout), Noise(np.full(6, 0.05), 0.0, 0.0, 0.0, 1.0, 2.0, True)
    found = make_believed(bench, noise, keep=False)
    modulus = found.target.correction.modulus
    assert 1.2 < modulus < 1.6
    scale = np.where(layout.of_markers(), 1.0, modulus)
    np.testing.assert_allclose(
        found.null.nuisances, noise.whitened(scale * found.nuisances.columns, layout), atol=1e-12
    )


def _swept_volume(mesh, motion):
    corners = mesh.nodes[mesh.surface]
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.abs((normals * motion[mesh.surface].mean(axis=1)).sum(axis=1).sum()))


def _area(mesh, nodes, of):
    corners = mesh.nodes[mesh.surface[of(np.isin(mesh.surface, nodes), axis=1)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normals, axis=1).sum())


def test_columns_of_the_shape_are_read_from_the_cache_where_nothing_they_depend_on_has_changed(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))
    believed = rig()
    bench = Bench(believed, SignalLayout(believed))
    made = shape_nuisances(bench, bench.base, keep=True)
    for direction, column in shape_columns(bench, bench.base):
        assert np.array_equal(dict(made)[direction.name], direction.std_mm * column)

    def refused(*_, **__):
        raise AssertionError

    monkeypatch.setattr(shape, "shape_columns", refused)
    again = shape_nuisances(bench, bench.base, keep=True)
    assert [name for name, _ in again] == [name for name, _ in made]
    assert all(np.array_equal(one, other) for (_, one), (_, other) in zip(again, made, strict=True))
    top, side = believed.actuators
    wider = replace(DEFAULT, shape=replace(DEFAULT.shape, place_share=0.1))
    for other, settings in (
        (replace(believed, surface_std=0.5), DEFAULT),
        (replace(believed, surface_length=20.0), DEFAULT),
        (replace(believed, actuators=(top, replace(side, edge_std=0.5))), DEFAULT),
        (replace(believed, boundaries=(replace(believed.boundaries[0], edge_std=0.5),)), DEFAULT),
        (replace(believed, material=replace(believed.material, poisson=0.3)), DEFAULT),
        (believed, wider),
    ):
        with pytest.raises(AssertionError):
            shape_nuisances(Bench(other, bench.layout, settings=settings), bench.base, keep=True)
    monkeypatch.setattr(shape, "FINE_SCHEMA", -1)
    with pytest.raises(AssertionError):
        shape_nuisances(bench, bench.base, keep=True)
