"""Partly wrong supports: the truth is held as described, the user states otherwise, and runs are stored separately."""

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

skfem = pytest.importorskip("skfem")

from blind.generator.solver import Physics  # noqa: E402  (needs skfem)
from loadfree import archive, run  # noqa: E402
from loadfree.events import events_of  # noqa: E402
from loadfree.generator import supports as made  # noqa: E402
from loadfree.generator.contacts import Contact  # noqa: E402
from loadfree.generator.meshing import box_bricks  # noqa: E402
from loadfree.generator.solve import prepare, solve  # noqa: E402
from loadfree.rivals import Case  # noqa: E402
from loadfree.supports import BODIES, KINDS, SUPPORTS, read_supports  # noqa: E402

SIZE = (40.0, 40.0, 20.0)
bodies = pytest.mark.parametrize("name", BODIES)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_support_holds_stays_and_the_rest_of_the_base_moves(kind):
    nodes, tets = box_bricks(SIZE, (8, 8, 3), np.random.default_rng(0))
    outline = made.Outline(nodes[nodes[:, 2] == 0.0])
    support = made.Support.drawn(kind, outline, np.random.default_rng(1))
    mesh = skfem.MeshTet(nodes.T.copy(), tets.T.copy())
    body = made.PartlyHeldBody(mesh, 2, lambda places: support.holds(places, outline))
    push = Contact("traction", (20.0, 20.0, 20.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (8.0, 8.0), (0.6, 0.0, -0.8))
    start = prepare(body, Physics(), [push], (0.0, 0.0, 0.0), [1.0], 1.0)
    solve(start)
    moved, places = np.linalg.norm(start.run.u, axis=1), body.places.T
    base = np.abs(places[:, 2]) < 1e-9
    held = support.holds(places, outline) & np.isin(np.arange(body.n_nodes), body.nodes_of(mesh.boundary_facets()))
    assert np.all(moved[held] == 0.0)
    assert np.all(moved[~held] > 0.0)
    assert (kind == "band") == bool(np.all(held[base]))
    assert (kind == "band") == bool(np.any(held & ~base))
    assert np.array_equal(np.sort(body.closed_nodes), np.flatnonzero(base | held))


def test_an_outline_is_0_in_the_middle_and_1_on_the_rim():
    corners = np.array([[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0.0]])
    outline = made.Outline(corners)
    np.testing.assert_allclose(outline.share(corners), 1.0)
    np.testing.assert_allclose(
        outline.share(np.array([[2, 1, 0], [3, 1, 0], [2, 1.5, 0.0]])), [0, 0.5, 0.5], atol=1e-12
    )
    assert outline.share(np.array([[*outline.at(0.7, 2.0), 0.0]]))[0] == pytest.approx(0.7)


@bodies
def test_each_half_has_every_support_once_and_halves_share_simple_contacts(name):
    for half in ("dev", "test"):
        events = events_of(read_supports(name), half)
        assert Counter(event.description["support"]["kind"] for event in events) == dict.fromkeys(KINDS, 1)
        assert sum(event.kind in made.SIMPLE for event in events) == 2
    assert [event.description["support"]["kind"] for event in read_supports(name).events] == [
        k for k in KINDS for _ in (0, 1)
    ]


@bodies
def test_events_hold_the_user_s_nodes_where_they_say(name):
    body = read_supports(name)
    mesh = body.mesh
    outline = made.Outline(mesh.nodes[mesh.fixed_nodes])
    for event in body.events:
        support = made.Support(**event.description["support"])
        held = support.holds(mesh.nodes[mesh.surface_nodes], outline)
        moved = np.linalg.norm(event.nodes, axis=1)
        # The true mesh has its nodes elsewhere: at the rim of what is held the user's move a little.
        assert np.median(moved[mesh.surface_nodes[held]]) < 0.05 * moved.mean()
        assert moved[mesh.fixed_nodes].max() > 0.05 or support.kind == "band"
        assert np.quantile(np.linalg.norm(event.pool, axis=1), 0.85) > 0.29


def test_doubted_supports_may_give_way_and_others_do_not():
    body = read_supports("phantom")
    event = next(event for event in body.events if event.description["support"]["kind"] == "patches")
    rest = body.mesh.nodes[body.mesh.fixed_nodes]
    bent = {}
    for name in ("perhaps", "sure"):
        # The tracker may have drifted: what is held sure moves rigidly at most (a mean of turns is nearly one).
        moved = rest + SUPPORTS.methods[name](Case(body, event, "spread")).nodes[body.mesh.fixed_nodes]
        turn, _ = Rotation.align_vectors(moved - moved.mean(axis=0), rest - rest.mean(axis=0))
        bent[name] = np.abs(turn.apply(rest - rest.mean(axis=0)) - (moved - moved.mean(axis=0))).max()
    assert bent["sure"] < 2e-3
    assert bent["perhaps"] > 0.05


def test_runs_are_kept_beside_those_of_the_other_bench(tmp_path, monkeypatch):
    for module, name in ((archive, "RESULTS"), (archive, "SCRATCH"), (run, "SCRATCH")):
        monkeypatch.setattr(module, name, tmp_path)
    run.main(["--bodies", "hole", "--methods", "none"], SUPPORTS)
    assert {path.name for path in tmp_path.iterdir()} == {"supports-dev", "supports-dev-none.jsonl"}
    answer = archive.read_results(tmp_path / "supports-dev")
    assert [event["support"] for event in answer["events"]] == list(KINDS)
    assert {row["layout"] for row in answer["rows"]["none"]} == set(SUPPORTS.layouts)
