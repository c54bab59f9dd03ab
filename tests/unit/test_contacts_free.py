"""A body that nothing holds: its answer turns with the tracker, and where it lies is uncertain."""

from typing import Any

import numpy as np
import pytest

import tissuereg as tr
from support import doors
from support.pushes import ELEMENT, MATERIAL, push
from tissuereg.registration.contacts.spread import linear_fields
from tissuereg.registration.contacts.state import RigidMotion

INNER = {"deep": (40.0, 20.0, 9.0), "near": (24.0, 35.0, 15.0)}

#: The tracker's frame, far from that of the body. Half a turn about an axis: signs change and no number is rounded
#: otherwise, so that the chains take the same steps.
TURNED = RigidMotion(np.diag([-1.0, 1.0, -1.0]), np.array([50.0, -20.0, 10.0]))


def registered(frame: RigidMotion) -> tr.Registration:
    markers = push().markers()
    observed = tr.Markers(markers.reference, frame.apply(markers.measured), 0.03)
    options: dict[str, Any] = {"material": MATERIAL, "element": ELEMENT, "threads": 1, "targets": INNER}
    free = tr.Mesh(push().mesh.nodes, push().mesh.tets)
    return doors.registered(free, observed, held="free", **options)


@pytest.fixture(scope="module")
def still() -> tr.Registration:
    return registered(RigidMotion.still())


@pytest.fixture(scope="module")
def turned() -> tr.Registration:
    return registered(TURNED)


def places(result: tr.Registration, displacement: np.ndarray) -> np.ndarray:
    return np.asarray(result.mesh.nodes + displacement)


def test_a_body_in_a_turned_frame_is_the_same_body_turned(still: tr.Registration, turned: tr.Registration) -> None:
    wanted = TURNED.apply(places(still, still.displacement))
    assert np.abs(places(turned, turned.displacement) - wanted).max() < 1e-6
    for name in INNER:
        one, two = still.target(name), turned.target(name)
        assert two.mean == pytest.approx(TURNED.apply(one.mean), abs=1e-6)
        by_turn = TURNED.rotation @ one.covariance @ TURNED.rotation.T
        assert np.abs(two.covariance - by_turn).max() < 1e-5 * np.abs(by_turn).max()
        assert two.constrained == pytest.approx(one.constrained, abs=1e-6)
    assert still.node_covariance is not None
    assert turned.node_covariance is not None
    # From 64 draws, alike in both frames but for the signs of the noise.
    of_nodes = TURNED.rotation @ still.node_covariance @ TURNED.rotation.T
    off = np.abs(turned.node_covariance - of_nodes).max(axis=(1, 2))
    assert np.median(off / np.trace(of_nodes, axis1=1, axis2=2)) < 0.1


def test_forces_and_contacts_turn_with_the_body(still: tr.Registration, turned: tr.Registration) -> None:
    assert still.forces is not None
    assert turned.forces is not None
    by_turn = still.forces @ TURNED.rotation.T
    assert np.abs(turned.forces - by_turn).max() < 1e-5 * np.abs(by_turn).max()
    assert still.contacts
    assert np.abs(still.contacts[0].direction).min() > 0.01
    for one, two in zip(still.contacts, turned.contacts, strict=True):
        # Places are those of the undeformed body, whose frame has not turned.
        assert two.centre_mm == pytest.approx(one.centre_mm)
        assert two.direction == pytest.approx(TURNED.rotation @ one.direction, abs=1e-5)
        assert two.force_mN == pytest.approx(one.force_mN, rel=1e-5)


def test_draws_of_a_free_body_move_as_a_whole_as_well(turned: tr.Registration) -> None:
    draw: Any = turned.draw
    drawn = turned.draws(16)
    simulator, first = draw.fit.columns.body.simulator, turned.mesh.nodes
    coefficients, beside = draw.drawn(16)
    for field, one, apart in zip(drawn, coefficients, beside, strict=True):
        # Taken back by its own motion, a draw is the equilibrium under its load, in the body's frame.
        frame = draw.fit.state.frame.followed_by(draw.fit.columns.frame(one), draw.fit.columns.rigid)
        back = frame.undo(places(turned, field)) - first - apart
        found = simulator.solve(
            draw.fit.columns.load(one),
            MATERIAL,
            springs=draw.fit.columns.springs,
            start=draw.fit.state.displacement,
            tolerance=1e-8,
        )
        assert np.abs(back - found.displacement).max() < 1e-3 * np.abs(found.displacement).max()


def test_where_a_free_body_lies_is_uncertain_by_the_noise_of_its_markers_at_least(turned: tr.Registration) -> None:
    draw: Any = turned.draw
    coefficients = draw.spread.coefficients(np.random.default_rng(0), 64)
    motions = np.array([draw.fit.columns.frame(one) for one in coefficients])
    assert motions.std(axis=0).min() > 0.5 * 0.03 / np.sqrt(len(push().nodes))


def test_nodes_are_as_uncertain_as_points_there_rigid_motion_included(turned: tr.Registration) -> None:
    draw: Any = turned.draw
    fit, nodes = draw.fit, turned.mesh.surface_nodes[::9]
    rows = [(np.array([node]), np.eye(3)[axis : axis + 1]) for node in nodes for axis in range(3)]
    here = turned.mesh.nodes[nodes] + fit.state.displacement[nodes]
    wanted = np.trace(draw.spread.points(rows, here).covariance, axis1=1, axis2=2)
    # As the mean over nodes of variances from 64 draws has it.
    assert np.mean(turned.std[nodes] ** 2) == pytest.approx(wanted.mean(), rel=0.35)
    frame = next(family.columns for family in fit.columns.families if family.name == "frame")
    change = np.zeros((1, fit.columns.n_columns))
    change[0, frame.start] = 2.0
    alone = linear_fields(fit, change, np.zeros((1, turned.mesh.n_nodes, 3)))
    assert alone[0] == pytest.approx(np.tile([2.0, 0.0, 0.0], (turned.mesh.n_nodes, 1)), abs=1e-9)
