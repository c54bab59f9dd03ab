"""Points of a surface without labels: matching, their rows, noise, thinning, rigid start, projection."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation
from tissuereg.body.surface import MOST_POINTS, SurfacePoints, evenly
from tissuereg.errors import MarkerError, ModelError, SurfaceError
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.measured import MarkerData, ObservedData, tail_cost, tail_variance
from tissuereg.registration.contacts.observations import Basis, moving_variances
from tissuereg.registration.contacts.sensed import Sensed
from tissuereg.registration.contacts.settings import MATCHING, ContactSettings
from tissuereg.registration.contacts.state import BodyState, RigidMotion
from tissuereg.registration.contacts.supports import Supports
from tissuereg.registration.contacts.surface_points import PointData, closest_feet, closest_frame, facet_errors
from tissuereg.registration.readings.clouds import suspect_points


def cloud(mesh, displacement, count, rng, noise=0.0):
    """Return random points of the deformed free surface with noise, mm."""
    free = mesh.surface[~np.isin(mesh.surface, mesh.node_sets.get("fixed", [])).all(axis=1)]
    chosen = rng.integers(len(free), size=count)
    weights = rng.dirichlet(np.ones(3), size=count)
    places = np.einsum("pc,pcx->px", weights, (mesh.nodes + displacement)[free[chosen]])
    return places + noise * rng.standard_normal((count, 3))


def bent(mesh):
    """Return a smooth displacement that holds the base, mm."""
    x, y, z = mesh.nodes.T
    return np.stack([0.004 * z**2, 0.001 * x * z, -0.02 * z * y / 20.0], axis=1)


@pytest.fixture(scope="module")
def leaning(block_mesh):
    return BodyState(np.zeros(1), bent(block_mesh), RigidMotion.still())


def test_feet_of_points_on_the_surface_are_the_points(block_mesh, leaning):
    points = cloud(block_mesh, leaning.displacement, 200, np.random.default_rng(0))
    feet = closest_feet(block_mesh.nodes + leaning.displacement, block_mesh.surface, points)
    assert np.allclose(feet.places, points, atol=1e-9)
    again = np.einsum("pc,pcx->px", feet.weights, (block_mesh.nodes + leaning.displacement)[feet.corners])
    assert np.allclose(again, points, atol=1e-9)
    assert np.allclose(np.linalg.norm(feet.normals, axis=1), 1.0)


def test_feet_are_the_closest_places_of_all_triangles(block_mesh, leaning):
    trimesh = pytest.importorskip("trimesh")
    moved = block_mesh.nodes + leaning.displacement
    points = np.random.default_rng(1).uniform(-5, 45, (300, 3))
    found = closest_feet(moved, block_mesh.surface, points)
    surface = trimesh.Trimesh(moved, block_mesh.surface, process=False)
    _, exact, _ = trimesh.proximity.closest_point(surface, points)
    mine = np.linalg.norm(points - found.places, axis=1)
    assert np.all(mine >= exact - 1e-9)
    # Few samples of the surface are compared: a foot may lie on the second closest triangle.
    assert np.mean(mine > exact + 1e-9) < 0.03


def test_the_row_of_a_point_is_the_derivative_of_its_residual(block_mesh, leaning):
    points = cloud(block_mesh, leaning.displacement, 40, np.random.default_rng(2), noise=0.3)
    seen = PointData(block_mesh, points, 0.1, 0.02)
    reading = seen.read(leaning)
    # A rigid push of every node along an axis moves each foot by it: the residual shrinks by its part along the normal.
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        moved = BodyState(leaning.coefficients, leaning.displacement + step, RigidMotion.still())
        change = (seen.read(moved).residual - reading.residual) / 1e-6
        by_row = -np.array([weights.sum(axis=0)[axis] for _, weights in reading.rows])
        inner = seen.feet(leaning).weights.min(axis=1) > 0.02  # a foot on an edge may jump to the next triangle
        assert inner.sum() > 20
        assert np.allclose(change[inner], by_row[inner], atol=1e-4)


def test_sliding_along_the_surface_is_not_seen(block_mesh):
    still = BodyState(np.zeros(1), np.zeros((block_mesh.n_nodes, 3)), RigidMotion.still())
    top = np.stack([*np.meshgrid(np.linspace(8, 22, 6), np.linspace(6, 14, 5)), np.full((5, 6), 40.0)], axis=-1)
    seen = PointData(block_mesh, top.reshape(-1, 3), 0.1, 0.02)
    slid = BodyState(np.zeros(1), np.tile((1.5, -1.0, 0.0), (block_mesh.n_nodes, 1)), RigidMotion.still())
    assert np.allclose(seen.read(slid).residual, seen.read(still).residual, atol=1e-12)
    assert np.allclose(seen.read(still).directions, (0.0, 0.0, 1.0))


def test_the_noise_of_a_point_grows_with_what_is_left_of_it():
    squares = np.array([0.0, 1.0, 100.0, 1e6])
    factor = np.sqrt(tail_variance(squares, 1))
    assert factor[1] == pytest.approx(1.0)
    assert np.sqrt(squares / factor**2).max() < np.sqrt(7.0)  # no point is ever more than so many deviations off
    assert np.all(np.diff(tail_cost(squares, 1)) > 0)
    # The factor is what makes a Gaussian's slope that of Student's cost: d cost / d squares = 1 / factor^2.
    slope = (tail_cost(100.0 + 1e-6, 1) - tail_cost(100.0 - 1e-6, 1)) / 2e-6
    assert slope == pytest.approx(1.0 / factor[2] ** 2, rel=1e-6)


def test_the_error_of_the_model_is_shared_by_points_close_to_each_other_and_noise_is_not(block_mesh):
    drawn = BodyState(np.zeros(1), np.tile([0.0, 0.0, 3.0], (block_mesh.n_nodes, 1)), RigidMotion.still())
    many = np.array([[5.0, 5.0, 43.0]] * 6 + [[25.0, 15.0, 43.0]])
    seen = PointData(block_mesh, many, 0.05, 0.02)
    std = seen.std(drawn, seen.feet(drawn))
    assert std[-1] == pytest.approx(np.hypot(0.05, 0.02 * 3.0))
    assert std[:6] == pytest.approx(np.sqrt(0.05**2 + 6 * (0.02 * 3.0) ** 2))


def test_flat_faces_have_no_facet_error_and_a_curved_surface_has_that_of_its_edges(block_mesh):
    assert np.max(facet_errors(block_mesh)) < 1e-6
    phantom = tr.phantom.phantom_mesh("small")
    errors = facet_errors(phantom)
    assert 0.02 < np.median(errors) < 0.1  # edges of 7 mm on a radius of 60 mm: an arrow height of 0.1 mm


def test_many_points_are_thinned_evenly_and_their_rows_are_known():
    rng = np.random.default_rng(3)
    given = rng.uniform(0, 100, (3000, 3))
    given[7] = np.nan
    points = SurfacePoints(given, std=0.2)
    assert (len(points), points.given) == (MOST_POINTS, 2999)
    assert np.array_equal(points.places, given[points.rows])
    gaps = np.linalg.norm(points.places[:, None] - points.places[None], axis=2) + 1e9 * np.eye(len(points))
    chance = given[rng.choice(np.setdiff1d(np.arange(3000), 7), MOST_POINTS, replace=False)]
    chance_gaps = np.linalg.norm(chance[:, None] - chance[None], axis=2) + 1e9 * np.eye(len(chance))
    assert gaps.min() > 5.0 * chance_gaps.min()
    assert np.array_equal(evenly(given[8:20], 500), np.arange(12))


@pytest.mark.parametrize(
    ("points", "std", "message"),
    [
        ([[0, 0, 0], [1, 1, 1]], 0.1, r"at least 3 points, got 2"),
        ([[0, 0, np.inf], [1, 1, 1], [2, 2, 2]], 0.1, r"must be finite"),
        (np.zeros((4, 3)), 0.0, r"`std` must be positive"),
    ],
)
def test_bad_points_are_refused(points, std, message):
    with pytest.raises(SurfaceError, match=message):
        SurfacePoints(points, std)


def test_neither_markers_nor_points_is_refused(block_mesh):
    with pytest.raises(MarkerError, match="markers or points of the surface must be given"):
        tr.register(block_mesh)


def test_points_with_a_trained_model_are_refused(block_mesh):
    with pytest.raises(ModelError, match="without a trained model"):
        tr.register(block_mesh, surface=block_mesh.nodes[block_mesh.surface_nodes], model="phantom")


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "metres"), (0.1, "centimetres"), (1.0 / 25.4, "inches")])
def test_points_in_other_units_are_refused_with_the_unit_named(block_mesh, factor, unit):
    far = tr.Mesh(block_mesh.nodes + np.array([100.0, 50.0, 20.0]), block_mesh.tets, {"fixed": block_mesh.fixed_nodes})
    points = cloud(far, bent(block_mesh), 100, np.random.default_rng(4), 0.1)
    with pytest.raises(SurfaceError, match=f"unit: .* in {unit}"):
        tr.register(far, surface=factor * points)


def test_points_in_another_frame_are_suspected(block_mesh):
    far = tr.Mesh(block_mesh.nodes + np.array([30.0, 20.0, 20.0]), block_mesh.tets, {"fixed": block_mesh.fixed_nodes})
    points = cloud(far, bent(block_mesh), 100, np.random.default_rng(4), 0.1)
    assert suspect_points(far, points, free=False) == []
    (found,) = suspect_points(far, points * (-1.0, -1.0, 1.0), free=False)
    assert (found.kind, "-x, -y, z" in found.sentence) == ("frame", True)


def test_a_free_bodys_units_are_recognised_by_its_size(block_mesh):
    points = cloud(block_mesh, bent(block_mesh), 100, np.random.default_rng(4), 0.1)
    assert suspect_points(block_mesh, points + 300.0, free=True) == []
    assert suspect_points(block_mesh, 0.001 * points, free=True)[0].kind == "unit"


def test_a_rigid_motion_is_found_from_points_of_a_part(block_mesh):
    rng = np.random.default_rng(5)
    points = cloud(block_mesh, np.zeros_like(block_mesh.nodes), 400, rng, 0.05)
    points = points[points[:, 0] > 6.0]  # one side is hidden
    turn = RigidMotion.still().followed_by(
        np.array([6.0, -4.0, 3.0, 5.0, -3.0, 6.0]), np.stack([block_mesh.nodes.mean(axis=0), np.full(3, 20.0)])
    )
    found = closest_frame(block_mesh, turn.apply(points))
    assert np.linalg.norm(found.apply(block_mesh.nodes) - turn.apply(block_mesh.nodes), axis=1).max() < 0.5


def test_a_projection_keeps_what_causes_can_do(block_mesh):
    body = ContactBody.of(block_mesh, Supports.of(block_mesh, "sure"))
    settings = ContactSettings()
    columns = Columns.of(body, tr.Material(10.0), body.simulator.load_parts(tr.Load()), settings)
    still = BodyState(np.zeros(columns.n_columns), np.zeros((block_mesh.n_nodes, 3)), RigidMotion.still())
    seen = PointData(block_mesh, cloud(block_mesh, 0.0, 300, np.random.default_rng(6)), 0.1, 0.02)
    reading = seen.read(still)
    from tissuereg.simulation.sensitivity import Linearised, Observation

    here = Linearised(body.simulator, tr.Load(), tr.Material(), still.displacement)
    responses = columns.responses(
        Sensed(here.compliance([Observation(*row) for row in reading.rows])), np.empty((0, 3))
    )
    variances = moving_variances(columns, settings)
    basis = Basis.of(reading, responses, variances, 60)
    assert len(basis.vectors) <= 60
    white = responses / reading.std[:, None]
    lost = white - basis.vectors.T @ (basis.vectors @ white)
    # No patch has a signal above the stated one in any direction that was dropped.
    signal = np.sum(lost**2, axis=0) * variances
    assert signal.max() <= basis.dropped_signal * (len(reading.residual) - len(basis.vectors))
    assert signal.max() < 0.02 * (np.sum(white**2, axis=0) * variances).max()
    # The rows of the projection are the projection of the rows.
    few = here.compliance([Observation(*row) for row in basis.rows(reading)])
    few = columns.responses(Sensed(few), np.empty((0, 3)))
    assert np.allclose(few, (basis.vectors / reading.std) @ responses, atol=1e-6 * np.abs(few).max())


def test_thirty_markers_projected_and_plain_agree(block_mesh, monkeypatch):
    top = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 40 - 1e-9).all(axis=1)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.2, 0.07, 0.03))), tr.Material(10.0, 0.45)).displacement
    rng = np.random.default_rng(8)
    nodes = rng.choice(block_mesh.surface_nodes[block_mesh.nodes[block_mesh.surface_nodes, 2] > 8], 30, replace=False)
    markers = tr.Markers(
        block_mesh.nodes[nodes], (block_mesh.nodes + truth)[nodes] + 0.1 * rng.standard_normal((30, 3))
    )
    targets = {"deep": (18.0, 12.0, 22.0), "top": (12.0, 8.0, 34.0)}
    plain = tr.register(block_mesh, markers, targets=targets)
    monkeypatch.setattr("tissuereg.registration.contacts.measured.MATCHING", replace(MATCHING, most_plain=60))
    few = tr.register(block_mesh, markers, targets=targets)
    moved = np.linalg.norm(truth, axis=1).mean()
    # Measured at four seeds: 0.021 to 0.026 of the motion, seeds alone 0.005. Heavy tails weigh markers otherwise; what
    # that changes is less than either leaves unknown, a standard deviation of 0.04.
    apart = np.linalg.norm(few.displacement - plain.displacement, axis=1).mean()
    assert apart < 0.03 * moved
    assert apart < min(plain.std.mean(), few.std.mean())
    for name in targets:
        widths = [np.sqrt(np.trace(one.target(name).covariance)) for one in (plain, few)]
        assert 0.6 < widths[1] / widths[0] < 1.7


def test_a_wrong_marker_among_many_is_named_by_its_weight(block_mesh, monkeypatch):
    monkeypatch.setattr("tissuereg.registration.contacts.measured.MATCHING", replace(MATCHING, most_plain=20))
    top = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 40 - 1e-9).all(axis=1)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.2, 0.07, 0.03))), tr.Material(10.0, 0.45)).displacement
    nodes = block_mesh.surface_nodes[block_mesh.nodes[block_mesh.surface_nodes, 2] > 8][::4]
    measured = (block_mesh.nodes + truth)[nodes]
    measured[3] += (3.0, -3.0, 3.0)
    result = tr.register(block_mesh, tr.Markers(block_mesh.nodes[nodes], measured))
    assert result.markers.dropped == (("M4", "wrong"),)


def test_data_are_weighed_only_where_they_are_many(block_mesh):
    rng = np.random.default_rng(9)
    points = cloud(block_mesh, 0.0, 300, rng)
    places = block_mesh.nodes[block_mesh.surface_nodes[:10]]
    markers = tr.Markers(places, places)
    marks = MarkerData(MarkerObservation.of(block_mesh, markers), markers, 0.02)
    few, many = (PointData(block_mesh, points[:count], 0.1, 0.02) for count in (40, 300))
    assert not ObservedData.of(marks, few).weighed
    assert ObservedData.of(marks, many).weighed
    assert ObservedData.of(marks, few).n_obs == 70 < MATCHING.most_plain
    still = BodyState(np.zeros(1), np.zeros((block_mesh.n_nodes, 3)), RigidMotion.still())
    assert len(ObservedData.of(marks, few).read(still).groups) == 10
    assert ObservedData.of(marks, many).read(still).groups == []
