"""Bodies that are not as believed inside: what the archive holds, and that a ball inside grows as it is told to."""

from collections import Counter

import numpy as np
import pytest

skfem = pytest.importorskip("skfem")

from loadfree.events import events_of, read_set  # noqa: E402
from loadfree.generator.inner import BODIES, KINDS, N_EACH, InnerBench, plans  # noqa: E402


@pytest.mark.parametrize("name", BODIES)
def test_halves_share_the_kinds_and_say_what_is_inside(name):
    body = read_set(name, "inner")
    assert [event.kind for event in body.events] == [plan.kind for plan in plans(name)]
    for half in ("dev", "test"):
        assert Counter(event.kind for event in events_of(body, half)) == dict.fromkeys(KINDS, N_EACH // 2)
    for event in body.events:
        truth = event.description["truth"]
        if event.kind == "fibres":
            assert 2.0 <= truth["shape"]["k1"] <= 10.0
        else:
            assert 0.05 <= abs(truth["strain"]) <= 0.2
        assert np.abs(event.nodes[body.mesh.fixed_nodes]).max() == 0.0


def test_a_ball_grows_in_the_steps_of_the_load_and_nothing_else_does():
    bench = InnerBench("beam")
    plan = next(plan for plan in plans("beam") if plan.kind == "growth")
    physics = bench.physics(plan, np.random.default_rng(0))
    bench.body_under([])
    centre, radius, strain = bench.ball
    whole, half = physics.memory.growth(2.0), physics.memory.growth(1.0)
    inside = np.linalg.norm(bench.at_hand.points - centre, axis=-1) < radius
    assert inside.any()
    assert not inside.all()
    assert np.array_equal(whole, strain * inside)
    assert half == pytest.approx(0.5 * whole)
