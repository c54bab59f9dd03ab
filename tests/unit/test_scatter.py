"""Markers whose places are those of another body."""

import numpy as np
import pytest

from tissuereg.registration.readings.clouds import scattered

EXTENT = 120.0


@pytest.mark.parametrize("height", [0.0, 3.0, 6.0])
def test_markers_mounted_at_one_height_are_accepted_with_errors_of_two_millimetres(height):
    rng = np.random.default_rng(0)
    # The largest plausible error is 2.4 mm; at 2 mm the chance of an alarm is 1e-5.
    assert not any(scattered(height + 2.0 * rng.standard_normal(15), EXTENT) for _ in range(300))


def test_markers_that_were_placed_inside_are_accepted_at_any_depth():
    rng = np.random.default_rng(1)
    assert not scattered(-rng.uniform(0.0, 25.0, 15), EXTENT)


def test_distances_on_both_sides_that_no_mounting_explains_are_a_suspicion():
    rng = np.random.default_rng(2)
    found = [scattered(rng.uniform(-9.0, 9.0, 15), EXTENT) for _ in range(200)]
    # A standard deviation of 5.2 mm, where 3.9 mm are the limit.
    assert np.mean([bool(one) for one in found]) > 0.9
    one = next(each[0] for each in found if each)
    assert one.kind == "places"
    assert one.sentence.startswith("places: the markers lie from ")


def test_few_markers_tell_nothing_of_their_scatter():
    assert scattered(np.array([-9.0, 9.0, -9.0, 9.0]), EXTENT) == []
    assert scattered(np.array([-9.0, 9.0, -9.0, 9.0, -9.0]), EXTENT)
