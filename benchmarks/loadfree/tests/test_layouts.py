"""Layouts of markers and what a tracker sees of them."""

import numpy as np
import pytest

from loadfree.events import read_body
from loadfree.layouts import LAYOUTS, N_MARKERS, NOISE_MM, chosen, markers

BODY = read_body("dome")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_fifteen_places_of_the_pool_the_same_every_time(layout):
    for event in BODY.events[:5]:
        places = chosen(BODY, event, layout)
        assert len(set(places.tolist())) == N_MARKERS
        assert np.array_equal(places, chosen(BODY, event, layout))


def test_near_is_nearer_to_the_contacts_than_far():
    for event in BODY.events:
        near, far = (
            np.linalg.norm(BODY.pool[chosen(BODY, event, layout)][:, None] - event.centres, axis=2).min(axis=1)
            for layout in ("near", "far")
        )
        assert near.max() < far.min()


def test_spread_markers_keep_apart():
    gaps = {layout: [] for layout in ("spread", "random")}
    for event in BODY.events:
        for layout, found in gaps.items():
            points = BODY.pool[chosen(BODY, event, layout)]
            off = np.linalg.norm(points[:, None] - points, axis=2) + 1e3 * np.eye(N_MARKERS)
            found.append(off.min())
    assert min(gaps["spread"]) > np.median(gaps["random"])


def test_measured_is_the_truth_plus_noise_of_its_own_in_every_layout():
    off = []
    for event in BODY.events:
        for layout in LAYOUTS:
            seen = markers(BODY, event, layout)
            off.append(seen.displacement - event.pool[chosen(BODY, event, layout)])
            assert np.array_equal(seen.measured, markers(BODY, event, layout).measured)
    noise = np.concatenate(off)
    # 7,200 numbers: the standard deviation of theirs is 0.8 %.
    assert noise.std() == pytest.approx(NOISE_MM, rel=0.04)
    assert not np.allclose(off[0], off[1])
