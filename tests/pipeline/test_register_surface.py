"""Does a body register to points of its surface without labels? Alone, with markers or outliers, free, pulled far."""

import json

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.registration.contacts.state import RigidMotion

INNER = {"deep": (18.0, 12.0, 22.0), "near the top": (12.0, 8.0, 34.0)}


def cloud(mesh, displacement, count, rng, noise, *, seen_from=None):
    """Return noisy points of the deformed free surface, or of the half that faces a direction, mm."""
    free = mesh.surface[~np.isin(mesh.surface, mesh.node_sets.get("fixed", [])).all(axis=1)]
    corners = mesh.nodes[free]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    if seen_from is not None:
        area = area * (across @ np.asarray(seen_from) > 0)
    chosen = rng.choice(len(free), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), size=count)
    places = np.einsum("pc,pcx->px", weights, (mesh.nodes + displacement)[free[chosen]])
    return places + noise * rng.standard_normal((count, 3))


@pytest.fixture(scope="module")
def leaned(block_mesh):
    """A block pulled sideways at its top by another model than the believed one: ten-node elements, twice as stiff."""
    top = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 40 - 1e-9).all(axis=1)]
    load = tr.Load(traction=(top, (0.2, 0.07, 0.03)))
    return tr.simulate(block_mesh, load, tr.Material(16.0, 0.46), element="tet10").displacement


def off(result, truth):
    return float(np.linalg.norm(result.displacement - truth, axis=1).mean())


def motion(truth):
    return float(np.linalg.norm(truth, axis=1).mean())


def held_by_regions(result, mesh, truth):
    from tissuereg.body.observe import TargetObservation

    inside = TargetObservation(mesh, {name: target.reference for name, target in result.targets.items()})
    moved = inside.predict(truth[inside.nodes])
    for target, u in zip(result.targets.values(), moved, strict=True):
        left = target.mean - target.reference - u
        if left @ np.linalg.solve(target.covariance, left) > 16.3:  # 99.9 % of chi-square, 3 degrees
            return False
    return True


def test_points_alone_bring_the_body_there(block_mesh, leaned):
    points = cloud(block_mesh, leaned, 300, np.random.default_rng(1), 0.05)
    result = tr.register(block_mesh, surface=tr.SurfacePoints(points, 0.05), targets=INNER)
    assert off(result, leaned) < 0.15 * motion(leaned)
    assert held_by_regions(result, block_mesh, leaned)
    assert result.trust.ok, result.trust.reasons
    assert (result.markers.used, result.markers.dropped) == ((), ())
    assert (result.surface.points, result.surface.thinned_from) == (300, None)
    assert result.surface.used >= 290
    assert result.surface.after_rms_mm < 0.15 < result.surface.before_rms_mm
    assert result.min_det_f > 0


def test_half_of_the_surface_is_enough_with_wider_regions(block_mesh, leaned):
    points = cloud(block_mesh, leaned, 200, np.random.default_rng(2), 0.05, seen_from=(1.0, 0.6, 0.4))
    result = tr.register(block_mesh, surface=tr.SurfacePoints(points, 0.05), targets=INNER)
    assert off(result, leaned) < 0.3 * motion(leaned)
    assert held_by_regions(result, block_mesh, leaned)


def test_points_and_markers_together_are_no_worse_than_either(block_mesh, leaned):
    rng = np.random.default_rng(3)
    nodes = rng.choice(block_mesh.surface_nodes[block_mesh.nodes[block_mesh.surface_nodes, 2] > 8], 5, replace=False)
    measured = (block_mesh.nodes + leaned)[nodes] + 0.05 * rng.standard_normal((5, 3))
    markers = tr.Markers(block_mesh.nodes[nodes], measured, 0.05)
    points = cloud(block_mesh, leaned, 200, rng, 0.05)
    both = tr.register(block_mesh, markers, surface=tr.SurfacePoints(points, 0.05), targets=INNER)
    few = tr.register(block_mesh, markers, targets=INNER)
    assert off(both, leaned) < max(0.1 * motion(leaned), off(few, leaned))
    assert len(both.markers.used) == 5
    widths = [np.sqrt(np.trace(one.target("deep").covariance)) for one in (both, few)]
    assert widths[0] < widths[1]


def test_points_are_enough_where_no_marker_was_seen(block_mesh, leaned):
    places = block_mesh.nodes[block_mesh.surface_nodes[-4:]]
    points = cloud(block_mesh, leaned, 40, np.random.default_rng(5), 0.05)
    unseen = tr.register(block_mesh, tr.Markers(places), surface=points, targets=INNER)
    alone = tr.register(block_mesh, surface=points, targets=INNER)
    assert np.array_equal(unseen.displacement, alone.displacement)
    assert unseen.markers.dropped == tuple((name, "not seen") for name in ("M1", "M2", "M3", "M4"))


def test_few_points_and_markers_are_sampled_without_a_projection(block_mesh, leaned):
    rng = np.random.default_rng(3)
    nodes = rng.choice(block_mesh.surface_nodes[block_mesh.nodes[block_mesh.surface_nodes, 2] > 8], 8, replace=False)
    markers = tr.Markers(block_mesh.nodes[nodes], (block_mesh.nodes + leaned)[nodes])
    result = tr.register(block_mesh, markers, surface=cloud(block_mesh, leaned, 20, rng, 0.1), targets=INNER)
    assert off(result, leaned) < 0.2 * motion(leaned)
    assert len(result.markers.used) == 8
    # Points without labels may be matched wrongly; what no load explains could follow them.
    assert result.draw.fit.columns.unexplained is None
    assert result.explained_mm["unexplained"] == 0.0


def test_points_of_something_else_do_not_bend_the_body_and_are_listed(block_mesh, leaned):
    rng = np.random.default_rng(4)
    points = cloud(block_mesh, leaned, 300, rng, 0.05)
    wrong = rng.choice(300, 24, replace=False)
    points[wrong] += rng.normal(size=(24, 3)) + np.array([9.0, 4.0, 6.0])
    result = tr.register(block_mesh, surface=tr.SurfacePoints(points, 0.05))
    assert off(result, leaned) < 0.2 * motion(leaned)
    listed = set(result.surface.outliers.tolist())
    assert len(listed & set(wrong.tolist())) >= 18  # some lie on another part of the surface by chance
    assert len(listed - set(wrong.tolist())) <= 6


def test_tangential_motion_is_not_determined_by_points_and_regions_show_it(block_mesh):
    # The top slides over itself: points of the flat top alone determine its height, and nothing along it.
    rng = np.random.default_rng(5)
    top = np.column_stack([rng.uniform(6, 24, 120), rng.uniform(4, 16, 120), 40.0 + 0.05 * rng.standard_normal(120)])
    result = tr.register(block_mesh, surface=tr.SurfacePoints(top, 0.05), targets={"top": (15.0, 10.0, 39.0)})
    covariance = result.target("top").covariance
    assert covariance[0, 0] > 2.0 * covariance[2, 2]
    assert covariance[1, 1] > 2.0 * covariance[2, 2]


def test_a_free_body_is_found_by_its_points(block_mesh, leaned):
    rng = np.random.default_rng(6)
    turn = RigidMotion.still().followed_by(
        np.array([8.0, -5.0, 4.0, 4.0, -3.0, 5.0]), np.stack([block_mesh.nodes.mean(axis=0), np.full(3, 20.0)])
    )
    true = turn.apply(block_mesh.nodes + 0.3 * leaned)
    free = tr.Body(tr.Mesh(block_mesh.nodes, block_mesh.tets), held="free")
    points = turn.apply(cloud(block_mesh, 0.3 * leaned, 300, rng, 0.05))
    result = tr.register(free, surface=tr.SurfacePoints(points, 0.05))
    # A block slides in its own skin by nothing, but its centre is not determined exactly.
    assert np.linalg.norm(result.mesh.nodes + result.displacement - true, axis=1).mean() < 0.5


def test_a_far_pull_is_followed(block_mesh):
    top = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 40 - 1e-9).all(axis=1)]
    truth = tr.simulate(
        block_mesh, tr.Load(traction=(top, (0.3, 0.0, 0.1))), tr.Material(10.0, 0.45), element="tet10"
    ).displacement
    assert np.linalg.norm(truth, axis=1).max() > 0.25 * block_mesh.extent
    points = cloud(block_mesh, truth, 300, np.random.default_rng(7), 0.1)
    result = tr.register(tr.Body(block_mesh, element="tet4"), surface=points)
    assert off(result, truth) < 0.15 * motion(truth)


def test_the_same_seed_gives_the_same_bits_at_any_thread_count(block_mesh, leaned):
    points = cloud(block_mesh, leaned, 160, np.random.default_rng(1), 0.05)
    one, two = (
        tr.register(block_mesh, surface=points, targets=INNER, settings=tr.RegisterSettings(threads=threads))
        for threads in (1, 2)
    )
    assert np.array_equal(one.displacement, two.displacement)
    assert np.array_equal(one.target("deep").covariance, two.target("deep").covariance)


def test_more_than_five_hundred_points_are_thinned_and_work_is_bounded(block_mesh, leaned, tmp_path):
    points = cloud(block_mesh, leaned, 900, np.random.default_rng(8), 0.05)
    result = tr.register(block_mesh, surface=tr.SurfacePoints(points, 0.05), targets=INNER)
    assert (result.surface.points, result.surface.thinned_from) == (500, 900)
    # 150 and 500 points once, their projections in each further pass.
    assert result.work["right_hand_sides"] <= 650 + 60 * result.work["passes"]
    result.save(tmp_path / "out")
    saved = json.loads((tmp_path / "out" / "registration.json").read_text())
    assert set(saved["surface"]) == {
        "points",
        "used",
        "thinned_from",
        "before_rms_mm",
        "after_rms_mm",
        "outliers",
    }
    assert saved["markers"]["used"] == []
    page = result.report(tmp_path / "report.html").read_text()
    assert "of 500 surface points lie" in page
    assert "<h2>Surface</h2>" in page
    assert result.draws(2).shape == (2, block_mesh.n_nodes, 3)


def test_points_of_another_body_are_not_trusted(block_mesh):
    rng = np.random.default_rng(9)
    ball = rng.normal(size=(200, 3))
    points = np.array([15.0, 10.0, 25.0]) + 14.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    assert not tr.register(block_mesh, surface=points).trust.ok
