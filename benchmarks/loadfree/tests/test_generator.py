"""The other solver's contacts behave as named, on a small block."""

import numpy as np
import pytest

skfem = pytest.importorskip("skfem")

from blind.generator.solver import Physics  # noqa: E402  (needs skfem)
from loadfree.generator.bodies import BODIES  # noqa: E402
from loadfree.generator.contacts import Contact  # noqa: E402
from loadfree.generator.draw import DIFFERENCES, KINDS, Skin, plans  # noqa: E402
from loadfree.generator.meshing import box_bricks  # noqa: E402
from loadfree.generator.places import interpolation  # noqa: E402
from loadfree.generator.solve import HeldBody, prepare, solve  # noqa: E402

SIZE = (40.0, 24.0, 24.0)


@pytest.fixture(scope="module")
def block():
    nodes, tets = box_bricks(SIZE, (5, 3, 3), np.random.default_rng(0))
    return HeldBody(skfem.MeshTet(nodes.T.copy(), tets.T.copy()), 0)


def contact(kind, direction=(0.0, 0.0, -1.0), **rest):
    return Contact(kind, (30.0, 12.0, 24.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (7.0, 7.0), direction, **rest)


def event(block, *contacts, weight=(0.0, 0.0, 0.0), largest=1.5, **rest):
    shares = [1.0] * (len(contacts) + bool(np.any(weight)))
    start = prepare(block, Physics(poisson=0.45, **rest), list(contacts), weight, shares, largest)
    solve(start)
    return start.run


def top(run, distance=5.0):
    """Return displacements at a ring of points of the contact's patch."""
    turn = np.arange(8) * np.pi / 4
    points = [30.0, 12.0, 24.0] + distance * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    matrix, off = interpolation(run.body, points)
    assert off.max() < 1e-9
    return matrix @ run.u


def test_the_base_is_held_and_all_of_it(block):
    plane = np.flatnonzero(np.abs(block.places[0]) < 1e-9)
    assert np.array_equal(np.sort(block.base_nodes), plane)


def test_the_largest_displacement_is_what_was_wanted(block):
    run = event(block, contact("traction"), largest=1.5)
    assert np.linalg.norm(run.u, axis=1).max() == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("profile", ["uniform", "parabolic", "lopsided"])
def test_a_traction_s_force_is_its_integral(block, profile):
    run = event(block, contact("traction", (0.6, 0.0, -0.8), profile=profile))
    force, size = run.forces()[0], run.stroke[0] * run.parts[0][3]
    mean = 1.0 if profile == "uniform" else 0.5
    # Quadrature points inside or outside of the rim: a few percent.
    assert np.linalg.norm(force) == pytest.approx(size * mean * np.pi * 7.0**2, rel=0.08)
    np.testing.assert_allclose(force / np.linalg.norm(force), [0.6, 0.0, -0.8], atol=1e-9)


def test_a_bonded_pad_carries_its_patch_along(block):
    run = event(block, contact("bonded", (0.6, 0.0, -0.8)))
    stroke = run.stroke[0] * run.parts[0][3] * np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(top(run), np.tile(stroke, (8, 1)), atol=0.02)


def test_a_sliding_pad_gives_the_normal_displacement_alone_and_pulls_no_tangent(block):
    run = event(block, contact("sliding"))
    stroke = run.stroke[0] * run.parts[0][3]
    np.testing.assert_allclose(top(run)[:, 2], -stroke, atol=0.02)
    assert np.ptp(top(run)[:, 0]) > 0.05  # the skin slides outward under it
    np.testing.assert_allclose(run.forces()[0][:2], 0.0, atol=1e-9)


def test_contacts_and_weight_are_in_balance_with_the_base(block):
    run = event(block, contact("bonded"), weight=(0.0, 1.0, 0.0))
    residual, _ = run._residual(run.u, False)
    assert np.abs(residual).max() < 1e-3 * np.abs(run.forces()).max()
    # What holds the base: internal forces with nothing fixed and no contact.
    run.fixed[:] = False
    reaction, _ = run._residual(run.u, False)
    np.testing.assert_allclose(reaction[run.body.base_nodes].sum(axis=0), reaction.sum(axis=0), atol=0.05)
    volume = run.body.dx.sum()
    assert volume == pytest.approx(np.prod(SIZE))


def test_a_stiffer_body_takes_more_force_for_the_same_pad(block):
    runs = [event(block, contact("bonded"), young=young) for young in (10.0, 13.0)]
    soft, stiff = (np.linalg.norm(run.forces()[0]) / run.stroke[0] / run.parts[0][3] for run in runs)
    # The tie's own give is a few thousandths.
    assert stiff / soft == pytest.approx(1.3, rel=0.01)


@pytest.mark.parametrize("body", BODIES)
def test_both_halves_have_all_kinds_and_all_differences(body):
    for half in (0, 1):
        rows = plans(body)[half::2]
        assert {plan.kind for plan in rows} == set(KINDS)
        assert {plan.difference for plan in rows} == {None, *DIFFERENCES}


def test_contacts_of_one_event_do_not_touch_and_leave_the_base_alone(block):
    skin, rng = Skin(block), np.random.default_rng(2)
    for _ in range(20):
        first = skin.contact(rng, "bonded")
        assert first.centre[0] > 1.05 * max(first.radii)
        assert abs(np.dot(first.normal, first.side)) < 1e-5
        assert abs(np.dot(first.normal, first.direction)) >= 0.5 - 1e-5
