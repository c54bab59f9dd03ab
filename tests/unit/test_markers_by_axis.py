"""Markers whose noise differs from axis to axis."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.errors import MarkerError

PLACES = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])


def test_an_axis_of_infinite_noise_was_not_seen():
    markers = tr.Markers(PLACES, PLACES + 1.0, [[0.1, 0.2, np.inf], [0.3, 0.3, 0.3]])
    assert np.isnan(markers.measured[0, 2])
    assert np.isfinite(markers.measured[1]).all()
    assert markers.std[0] == pytest.approx(np.sqrt((0.01 + 0.04) / 2))
    assert np.isfinite(markers.axis_std).all()


def test_one_number_a_marker_is_that_of_all_axes():
    markers = tr.Markers(PLACES, PLACES, [0.1, 0.4])
    assert np.array_equal(markers.axis_std, [[0.1] * 3, [0.4] * 3])
    assert markers.std == pytest.approx([0.1, 0.4])


@pytest.mark.parametrize("std", [[[np.inf] * 3, [0.1] * 3], [[0.1, -0.1, 0.1], [0.1] * 3], [[np.nan] * 3] * 2])
def test_noise_must_be_positive_and_finite_along_some_axis(std):
    with pytest.raises(MarkerError, match="std must be positive"):
        tr.Markers(PLACES, PLACES, std)


def test_a_table_keeps_noise_by_axis(tmp_path):
    markers = tr.Markers(PLACES, PLACES + 1.0, [[0.1, 0.2, 0.5], [0.3, 0.3, 0.4]])
    from tissuereg.io.tables import read_markers, write_markers

    write_markers(tmp_path / "markers.csv", markers)
    again = read_markers(tmp_path / "markers.csv")
    assert np.array_equal(again.axis_std, markers.axis_std)
    assert np.array_equal(again.measured, markers.measured)
