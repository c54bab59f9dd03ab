"""Maps of forces from a rough mesh to a fine one."""

import numpy as np
import pytest

from tissuereg.simulation.fine.reading import force_maps
from tissuereg.simulation.settings import FINE


@pytest.fixture
def rough() -> np.ndarray:
    """Return the forces of a ramp there and back, nothing at both ends."""
    load = np.array([0.0, 0.3, 0.7, 1.0, 0.7, 0.3, 0.0])
    return load[:, None] * [900.0, 20.0, -50.0] + load[:, None] ** 2 * [0.0, -60.0, 10.0]


def test_loaded_frames_become_the_fine_ones_and_shares_of_them_shares(rough):
    fine = rough * np.linspace(1.1, 0.9, 7)[:, None] + 0.02 * rough[:, ::-1]
    maps = force_maps(rough, fine)
    np.testing.assert_allclose(np.einsum("fij,fj->fi", maps, 0.6 * rough), 0.6 * fine, rtol=1e-12, atol=1e-9)


def test_a_frame_without_load_has_the_map_of_the_least_loaded_one(rough):
    fine = rough * np.array([0.0, 1.1, 1.05, 1.0, 1.05, 1.2, 0.0])[:, None]
    rough[0] = 0.5 * FINE.least_loaded * rough[3]
    maps = force_maps(rough, fine)
    np.testing.assert_allclose(maps[[0, 6]], np.broadcast_to(1.1 * np.eye(3), (2, 3, 3)), atol=1e-12)


def test_frames_without_equilibrium_tell_nothing(rough):
    fine = 1.1 * rough
    fine[1] = rough[4] = np.nan
    maps = force_maps(rough, fine)
    np.testing.assert_allclose(maps, np.broadcast_to(1.1 * np.eye(3), (7, 3, 3)), atol=1e-12)


@pytest.mark.parametrize("force", [0.0, np.nan])
def test_a_pad_that_never_pushes_keeps_its_force(force):
    assert np.array_equal(force_maps(np.full((4, 3), force), np.zeros((4, 3))), np.broadcast_to(np.eye(3), (4, 3, 3)))


def test_forces_that_are_another_thing_give_no_wild_ratio(rough):
    maps = force_maps(rough, -5.0 * rough + 3.0 * rough[:, [1, 0, 2]])
    assert np.linalg.norm(maps - np.eye(3), ord=2, axis=(1, 2)).max() <= 2.0 * FINE.most_changed
    assert np.linalg.eigvals(maps).real.min() == pytest.approx(1.0 - FINE.most_changed)
