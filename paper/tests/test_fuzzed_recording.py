"""A recording of a rig that is nearly right: read, or refused by an error of ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.spoilt import CHANGES, FUZZED, reads_or_refuses, spoilt
from tissuereg_paper.studies.rigs import read_rig

#: A rig of the phantom experiment.
RECORDING = {
    **{name: np.zeros((1, 3)) for name in ("pad_centre_mm", "pad_direction", "markers_mm", "inner_mm")},
    **{name: np.ones(1) for name in ("pad_radius_mm", "pad_stroke_mm")},
    **{f"{name}_displacement_mm": np.zeros((2, 1, 3)) for name in ("marker", "inner")},
    "sensor_displacement_mm": np.zeros((2, 3)),
    "pad_force_mN": np.zeros((2, 1, 3)),
    "sensor_mm": np.zeros(3),
    "shares": [0.5, 1.0],
    "motion": [0.0, 1.0],
    "frame_s": 0.025,
    "truth": '{"scenario": 1, "seed": 0}',
}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "recording.npz"
    np.savez(path, **RECORDING)
    return path


@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_spoilt_recording_is_read_or_refused(good, changes):
    path = good.with_name("spoilt.npz")
    path.write_bytes(spoilt(good.read_bytes(), changes))
    reads_or_refuses(read_rig, path)


def test_the_recording_that_is_spoilt_is_a_good_one(good):
    assert len(read_rig(good).motion) == len(RECORDING["motion"])
