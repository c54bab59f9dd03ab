"""Rigid motions between the body's frame and the tracker's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from support.pushes import columns_of
from tissuereg.registration.contacts.state import RigidMotion

PLACES = np.random.default_rng(1).uniform(-30.0, 50.0, (12, 3))
RIGID = np.array([[4.0, -2.0, 11.0], [25.0, 25.0, 25.0]])


@pytest.fixture
def frame():
    return RigidMotion(Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([80.0, -15.0, 3.0]))


def test_there_and_back_again_is_still(frame):
    assert np.allclose(frame.undo(frame.apply(PLACES)), PLACES, atol=1e-12)
    assert np.allclose(frame.apply(frame.undo(PLACES)), PLACES, atol=1e-12)
    assert frame.moves
    assert not RigidMotion.still().moves
    assert np.array_equal(RigidMotion.still().apply(PLACES), PLACES)


def test_the_frame_between_places_is_the_motion_that_was_made(frame):
    found = RigidMotion.between(PLACES, frame.apply(PLACES))
    assert np.allclose(found.rotation, frame.rotation, atol=1e-12)
    assert np.allclose(found.shift, frame.shift, atol=1e-10)
    # Mirrored places: the best motion is a rotation all the same.
    assert np.linalg.det(RigidMotion.between(PLACES, PLACES * [-1, 1, 1]).rotation) == pytest.approx(1.0)


def test_followed_by_is_the_composition_of_both_motions(frame):
    coefficients = np.array([3.0, -2.0, 1.0, 6.0, -9.0, 4.0])
    turn = Rotation.from_rotvec(coefficients[3:] / 25.0).as_matrix()
    moved = RIGID[0] + (PLACES - RIGID[0]) @ turn.T + coefficients[:3]
    found = frame.followed_by(coefficients, RIGID)
    assert np.allclose(found.apply(PLACES), frame.apply(moved), atol=1e-11)
    assert np.allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-13)


def test_unit_motions_are_the_slope_of_the_composition():
    columns = columns_of("perhaps")
    step = 1e-4
    found = columns.rigid_field(PLACES)
    for k, unit in enumerate(np.eye(6)):
        there, back = (RigidMotion.still().followed_by(s * step * unit, columns.rigid).apply(PLACES) for s in (1, -1))
        assert np.allclose(found[k], (there - back) / (2 * step), atol=1e-8)
