"""The archive has its stated content, and its events can be made again."""

from collections import Counter

import numpy as np
import pytest

from loadfree.events import BODIES, KINDS, events_of, read_body, true_load
from loadfree.gaussian import in_tets, on_surface

N_EVENTS = 40

bodies = pytest.mark.parametrize("name", BODIES)


@bodies
def test_a_body_has_forty_events_in_two_like_halves(name):
    body = read_body(name)
    assert [event.number for event in body.events] == list(range(N_EVENTS))
    assert 1000 <= body.mesh.n_nodes <= 5000
    for half in ("dev", "test"):
        events = events_of(body, half)
        assert Counter(event.kind for event in events) == dict.fromkeys(KINDS, 4)
        assert sum(event.description["difference"] is not None for event in events) == N_EVENTS // 4


@bodies
def test_markers_and_targets_lie_in_the_body_off_its_nodes_and_its_base(name):
    body = read_body(name)
    assert body.pool.shape == (160, 3)
    assert body.targets.shape == (60, 3)
    for points, (nodes, weights) in ((body.pool, on_surface(body)), (body.targets, in_tets(body))):
        image = np.einsum("na,nax->nx", weights, body.mesh.nodes[nodes])
        assert np.abs(image - points).max() < 2e-4  # places are stored to 1e-4 mm
        assert weights.max() < 0.9
    base = body.mesh.nodes[body.mesh.fixed_nodes]
    assert np.linalg.norm(body.pool[:, None] - base, axis=2).min() > 0.04 * body.mesh.extent


@bodies
def test_events_move_the_body_and_the_markers_but_not_the_base(name):
    body = read_body(name)
    for event in body.events:
        assert np.all(event.nodes[body.mesh.fixed_nodes] == 0.0)
        assert 0.5 < np.linalg.norm(event.nodes, axis=1).max() < 1.1 * event.description["largest_mm"]
        assert np.quantile(np.linalg.norm(event.pool, axis=1), 0.85) > 0.29


@bodies
def test_fields_at_nodes_pool_and_targets_are_one_field(name):
    body = read_body(name)
    surface, inner = on_surface(body), in_tets(body)
    for event in body.events:
        for (nodes, weights), there in ((surface, event.pool), (inner, event.targets)):
            between = np.einsum("na,nax->nx", weights, event.nodes[nodes])
            off, moved = np.linalg.norm(between - there, axis=1), np.linalg.norm(there, axis=1)
            # What the user's linear elements cannot follow between nodes: at most 0.060, on the coarse phantom.
            assert off.mean() < 0.07 * moved.mean()


@bodies
def test_motions_spread_from_two_millimetres_up(name):
    largest = np.array([event.description["largest_mm"] for event in read_body(name).events])
    assert np.median(largest) > 3.0
    assert largest.max() < 28.0


def test_the_true_load_has_the_true_forces():
    body = read_body("hole")
    for event in body.events:
        load = true_load(body, event)
        whole = np.sum([contact["force_mN"] for contact in event.description["contacts"]], axis=0)
        np.testing.assert_allclose(load.forces.sum(axis=0), whole, atol=1e-6 * np.abs(whole).max() + 1e-9)
        assert (load.body_force is not None) == (event.kind == "gravity")


@pytest.mark.slow
def test_an_event_made_anew_is_what_is_stored():
    pytest.importorskip("skfem")
    from loadfree.generator.draw import plans
    from loadfree.generator.events import Bench

    event = min(
        read_body("beam").events, key=lambda event: (event.description["draw"], event.description["factorings"])
    )
    fields, description = Bench("beam").run(plans("beam")[event.number])
    for key, stored in (("nodes", event.nodes), ("pool", event.pool), ("targets", event.targets)):
        # Half a step of the archive, and another factor's rounding.
        assert np.abs(fields[key] - stored).max() < 0.6e-3
    assert [c["centre"] for c in description["contacts"]] == [c["centre"] for c in event.description["contacts"]]
    assert description["truth"] == event.description["truth"]
