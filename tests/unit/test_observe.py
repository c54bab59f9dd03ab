"""Markers and targets as functions of nodes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import MarkerError


def test_a_marker_off_the_surface_follows_a_rigid_motion_exactly(block_mesh):
    places = np.array([[20.0, 10.0, 45.0], [-6.0, 12.0, 15.0]])  # 5 mm above the top, 6 mm off a side
    observation = MarkerObservation(block_mesh, places, ("top", "side"))
    turn, shift = Rotation.from_rotvec([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -3.0])
    field = turn.apply(block_mesh.nodes.copy()) + shift - block_mesh.nodes
    np.testing.assert_allclose(
        observation.predict(field[observation.nodes]), turn.apply(places) + shift - places, atol=1e-12
    )


def test_a_marker_on_the_surface_is_linear_in_its_triangle(block_mesh):
    observation = MarkerObservation(block_mesh, [[13.0, 7.0, 40.0]], ("top",))
    gradient = np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.0], [0.3, 0.0, 0.05]])
    field = block_mesh.nodes @ gradient.T
    np.testing.assert_allclose(
        observation.predict(field[observation.nodes])[0], gradient @ [13.0, 7.0, 40.0], atol=1e-12
    )


#: On the top, above it, in the middle, and little and less little below the top of the block, whose extent is 40 mm.
MIXED = np.array([[13.0, 7.0, 40.0], [20.0, 10.0, 45.0], [14.0, 9.0, 21.0], [12.0, 8.0, 39.7], [12.0, 8.0, 39.4]])
NAMES = ("top", "above", "deep", "skin", "below")


@pytest.mark.parametrize("quadratic", [False, True])
def test_a_marker_inside_moves_with_its_tet_and_others_as_without_it(block_mesh, quadratic):
    rng = np.random.default_rng(2)
    n_nodes = block_mesh.n_nodes + quadratic * len(block_mesh.edges)
    field = rng.normal(size=(3, n_nodes, 3))
    observation = MarkerObservation(block_mesh, MIXED, NAMES, quadratic=quadratic)
    assert observation.inner.tolist() == [False, False, True, False, True]
    moved = observation.predict(field[:, observation.nodes])
    inner = {name: MIXED[NAMES.index(name)] for name in ("deep", "below")}
    target = TargetObservation(block_mesh, inner, quadratic=quadratic)
    np.testing.assert_allclose(moved[:, observation.inner], target.predict(field[:, target.nodes]))
    skin = MarkerObservation(block_mesh, MIXED[~observation.inner], NAMES[:3], quadratic=quadratic)
    np.testing.assert_allclose(moved[:, ~observation.inner], skin.predict(field[:, skin.nodes]))
    points = observation.points(n_nodes) @ field[0]
    np.testing.assert_allclose(observation.predict_points(points), moved[0], atol=1e-12)
    variation = observation.variation(field[0][observation.nodes])
    np.testing.assert_allclose(variation[~observation.inner], skin.variation(field[0][skin.nodes]))


def test_the_derivative_of_inner_markers_is_that_of_their_motion(block_mesh):
    rng = np.random.default_rng(3)
    observation = MarkerObservation(block_mesh, MIXED, NAMES)
    here, change = rng.normal(size=(2, len(observation.nodes), 3))
    by_step = (observation.predict(here + 1e-5 * change) - observation.predict(here - 1e-5 * change)) / 2e-5
    np.testing.assert_allclose(np.tensordot(observation.jacobian(here), change, 2), by_step, atol=1e-6)


def test_a_noisy_marker_may_lie_deeper_and_still_be_on_the_skin(block_mesh):
    by_noise = [MarkerObservation(block_mesh, MIXED, NAMES, std=std).inner.tolist() for std in (0.2, 0.4, 15.0)]
    assert by_noise == [[False, False, True, False, True], [False, False, True, False, False], [False] * 5]
    one = MarkerObservation.of(block_mesh, Markers(MIXED, None, [0.1, 0.1, 15.0, 0.1, 0.1], NAMES))
    assert one.inner.tolist() == [False, False, False, False, True]


def test_a_marker_stays_in_its_tet_where_the_mesh_is_moved(block_mesh):
    first = MarkerObservation(block_mesh, MIXED, NAMES)
    moved = Mesh(block_mesh.nodes + 0.2 * np.sin(block_mesh.nodes[:, ::-1]), block_mesh.tets, block_mesh.node_sets)
    there = MarkerObservation(moved, MIXED, NAMES, like=first)
    gradient = np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.0], [0.3, 0.0, 0.05]])
    field = moved.nodes @ gradient.T
    np.testing.assert_allclose(there.predict(field[there.nodes])[2], gradient @ MIXED[2], atol=1e-9)
    np.testing.assert_array_equal(there.inner, first.inner)


def test_a_marker_far_off_the_body_is_refused(block_mesh):
    with pytest.raises(MarkerError, match=r"marker 'far' is 160\.0 mm away .* check frame and units"):
        MarkerObservation(block_mesh, [[10.0, 10.0, 200.0]], ("far",))


def test_a_failed_member_does_not_spoil_the_others(block_mesh):
    observation = MarkerObservation(block_mesh, [[20.0, 10.0, 45.0]], ("top",))
    fields = np.zeros((3, len(observation.nodes), 3))
    fields[1] = np.nan
    moved = observation.predict(fields)
    assert np.isnan(moved[1]).all()
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-12)


def test_a_target_is_linear_in_its_tet(block_mesh):
    inside = TargetObservation(block_mesh, {"t": (11.0, 9.0, 17.0)})
    gradient = np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.0], [0.3, 0.0, 0.05]])
    field = block_mesh.nodes @ gradient.T
    np.testing.assert_allclose(inside.predict(field[inside.nodes])[0], gradient @ [11.0, 9.0, 17.0], atol=1e-12)


def test_many_targets_lie_in_the_tets_that_each_is_found_in(block_mesh):
    rng = np.random.default_rng(5)
    inside = block_mesh.nodes[block_mesh.tets[rng.integers(block_mesh.n_tets, size=40)]].mean(axis=1)
    places = np.concatenate([inside, block_mesh.nodes[:5], block_mesh.nodes[block_mesh.tets[:5, :2]].mean(axis=1)])
    named = {str(i): place for i, place in enumerate(places)}
    field = rng.standard_normal((block_mesh.n_nodes, 3))
    together = TargetObservation(block_mesh, named)
    found = together.predict(field[together.nodes])
    for i, (name, place) in enumerate(named.items()):
        alone = TargetObservation(block_mesh, {name: place})
        assert found[i] == pytest.approx(alone.predict(field[alone.nodes])[0], abs=1e-12)


def test_a_target_outside_is_refused_a_close_one_warned_of(block_mesh):
    with pytest.raises(MarkerError, match=r"target 'out' must lie in the undeformed body; .* mm outside"):
        TargetObservation(block_mesh, {"out": (20.0, 10.0, 60.0)})
    with pytest.warns(UserWarning, match="moves with the closest tet"):
        TargetObservation(block_mesh, {"near": (20.0, 10.0, 41.0)})


def test_a_quadratic_field_is_followed_exactly_where_mid_edge_nodes_are_given(block_mesh):
    def field(x):
        return np.stack([x[..., 0] * x[..., 1], x[..., 2] ** 2 - x[..., 0], x[..., 1] * x[..., 2]], axis=-1) / 50.0

    everywhere = np.concatenate([block_mesh.nodes, block_mesh.nodes[block_mesh.edges].mean(axis=1)])
    places = np.array([[13.0, 7.0, 40.0], [0.0, 9.0, 21.0]])
    markers = MarkerObservation(block_mesh, places, ("top", "side"), quadratic=True)
    np.testing.assert_allclose(markers.predict(field(everywhere)[markers.nodes]), field(places), atol=1e-12)
    inner = np.array([[11.0, 12.0, 17.0]])
    targets = TargetObservation(block_mesh, {"deep": inner[0]}, quadratic=True)
    np.testing.assert_allclose(targets.predict(field(everywhere)[targets.nodes]), field(inner), atol=1e-12)


def test_a_marker_off_the_surface_turns_with_its_patch_among_mid_edge_nodes_too(block_mesh):
    everywhere = np.concatenate([block_mesh.nodes, block_mesh.nodes[block_mesh.edges].mean(axis=1)])
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    places = np.array([[20.0, 10.0, 45.0]])
    observation = MarkerObservation(block_mesh, places, ("top",), quadratic=True)
    field = turn.apply(everywhere) - everywhere
    np.testing.assert_allclose(observation.predict(field[observation.nodes]), turn.apply(places) - places, atol=1e-12)


def test_the_variation_of_a_motion_is_that_of_the_corners_under_the_marker(block_mesh):
    places = np.array([[13.0, 7.0, 40.0], [13.0, 7.0, 44.0]])  # on the top, and 4 mm above the same place
    observation = MarkerObservation(block_mesh, places, ("on", "above"))
    shift = np.tile([1.0, -2.0, 3.0], (block_mesh.n_nodes, 1))
    np.testing.assert_allclose(observation.variation(shift[observation.nodes]), 0.0, atol=1e-12)
    stretch = np.zeros((block_mesh.n_nodes, 3))
    stretch[:, 0] = 0.1 * block_mesh.nodes[:, 0]
    on, above = observation.variation(stretch[observation.nodes])
    closest = np.unique(observation.nodes[observation._foot_nodes[0, :3]])
    width = np.ptp(block_mesh.nodes[closest, 0])
    assert on == pytest.approx(0.1 * width)
    corners = block_mesh.nodes[closest]
    longest = max(np.linalg.norm(a - b) for a in corners for b in corners)
    assert above == pytest.approx(on * (1.0 + 4.0 / longest))


def test_feet_that_are_kept_are_those_of_before_where_the_mesh_stands_and_move_along_their_edge_where_it_moves(
    block_mesh,
):
    mesh = block_mesh
    size = mesh.nodes.max(axis=0)
    # Above a face; beyond an edge of the body; beyond a corner.
    places = np.array([[0.4, 0.3, 1.0], [1.0, 0.37, 1.0], [1.0, 1.0, 1.0]]) * size
    places += np.array([[0.0, 0.0, 1.5], [1.2, 0.0, 0.8], [1.0, 1.0, 1.0]])
    before = MarkerObservation(mesh, places, ("a", "b", "c"))
    rng = np.random.default_rng(1)
    field = rng.normal(size=mesh.nodes.shape)
    same = MarkerObservation(mesh, places, ("a", "b", "c"), like=before)
    np.testing.assert_allclose(same.predict(field[same.nodes]), before.predict(field[before.nodes]), atol=1e-9)
    # A mesh that slides along the edge by a step: the foot goes back by as much, to first order.
    step = 1e-4 * np.array([0.0, 1.0, 0.0])
    slid = Mesh(mesh.nodes + step, mesh.tets, mesh.node_sets)
    kept, anew = (
        MarkerObservation(slid, places, ("a", "b", "c"), like=before),
        MarkerObservation(slid, places, ("a", "b", "c")),
    )
    np.testing.assert_allclose(kept.predict(field[kept.nodes])[:2], anew.predict(field[anew.nodes])[:2], atol=1e-9)
