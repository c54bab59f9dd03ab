"""The scores, on synthetic numbers whose figures are known."""

import numpy as np
import pytest

from loadfree.rivals import Answer
from loadfree.score import crps, figures, mahalanobis, scored

N_EVENTS, N_TARGETS = 60, 60


def rows_of(spread: float, believed: float, flags=None):
    """Return rows and events of errors with a true and a believed standard deviation a component, mm."""
    rng = np.random.default_rng(3)
    rows, events = [], {}
    for number in range(N_EVENTS):
        truth = rng.normal(size=(N_TARGETS, 3)) * 4.0
        nodes = rng.normal(size=(10, 3))
        answer = Answer(
            nodes + 0.1,
            truth + spread * rng.normal(size=truth.shape),
            np.tile(believed**2 * np.eye(3), (N_TARGETS, 1, 1)),
            flagged=None if flags is None else flags(truth),
        )
        rows.append(
            {"body": "beam", "event": number, "layout": "spread", "seconds": 0.1} | scored(nodes, truth, answer)
        )
        events["beam", number] = {
            "moved_um": np.linalg.norm(1e3 * truth, axis=1).round().astype(int).tolist(),
            "body_moved_mm": float(np.linalg.norm(nodes, axis=1).mean()),
        }
    return rows, events


def test_regions_of_a_calibrated_gaussian_hold_what_they_say():
    found = figures(*rows_of(0.3, 0.3))
    for name, share in (("cover50", 0.5), ("cover90", 0.9), ("cover95", 0.95)):
        # 3,600 targets: a standard deviation of at most 0.0083.
        assert found[name]["value"] == pytest.approx(share, abs=0.03)
        assert found[name]["low"] < found[name]["value"] < found[name]["high"]
    assert found["half_axis_mm"]["value"] == pytest.approx(0.3 * np.sqrt(6.251), abs=2e-3)


def test_regions_five_times_too_wide_or_too_narrow_are_found_out():
    wide, narrow = figures(*rows_of(0.3, 1.5)), figures(*rows_of(0.3, 0.06))
    assert wide["cover50"]["value"] > 0.99
    assert narrow["cover95"]["value"] < 0.05
    assert narrow["largest_m2"]["value"] > 100
    right = figures(*rows_of(0.3, 0.3))["crps_mm"]["value"]
    assert right < wide["crps_mm"]["value"]
    assert right < narrow["crps_mm"]["value"]


def test_crps_of_a_gaussian_is_that_of_its_integral():
    off, spread = 0.7, 0.4
    grid = np.linspace(-8, 8, 160001)
    from scipy.stats import norm

    integral = ((norm.cdf(grid, off, spread) - (grid >= 0)) ** 2).sum() * (grid[1] - grid[0])
    found = crps(np.full((1, 3), off), spread**2 * np.eye(3)[None])
    assert found[0] == pytest.approx(integral, abs=1e-4)
    assert crps(np.array([[-1.0, 2.0, 3.0]]), None)[0] == pytest.approx(2.0)


def test_mahalanobis_distances_follow_the_covariance():
    covariance = np.diag([4.0, 1.0, 0.25])[None]
    assert mahalanobis(np.array([[2.0, 1.0, 0.5]]), covariance)[0] == pytest.approx(3.0)


def test_body_error_and_worse_than_not_moving_compare_with_the_true_motion():
    rows, events = rows_of(0.3, 0.3)
    found = figures(rows, events)
    assert found["body_mm"]["value"] == pytest.approx(0.1 * np.sqrt(3), abs=1e-4)
    assert found["worse"]["value"] == 0.0
    for event in events.values():
        event["body_moved_mm"] = 0.1
    assert figures(rows, events)["worse"]["value"] == 1.0


def test_targets_that_move_most_are_the_upper_third():
    row = {
        "body": "beam",
        "event": 0,
        "layout": "far",
        "seconds": 0.0,
        "body_mm": 1.0,
        "off_um": [900, 10, 20, 30, 40, 60],
    }
    events = {("beam", 0): {"moved_um": [1, 2, 3, 4, 5, 6], "body_moved_mm": 2.0}}
    assert figures([row], events)["moving_mm"]["value"] == pytest.approx(0.05)


def test_flags_are_judged_by_what_they_hit():
    row = {"body": "beam", "event": 0, "layout": "far", "seconds": 0.0, "body_mm": 1.0}
    row |= {"off_um": [100, 100, 900, 900], "m2": [1.0, 1.0, 99.0, 1.0], "half_axis_um": [1] * 4, "crps_um": 1.0}
    events = {("beam", 0): {"moved_um": [1000] * 4, "body_moved_mm": 2.0}}
    found = figures([row | {"flagged": [1, 0, 1, 0]}], events)
    assert found["flagged"]["value"] == 0.5
    assert found["cover90"]["value"] == 0.75
    assert found["cover90_unflagged"]["value"] == 1.0  # the target far outside its region was flagged
    assert found["good_flagged"]["value"] == 0.5  # one of two targets that are off by 10 %
    assert found["flags_good"]["value"] == 0.5
    assert figures([row | {"flagged": [0] * 4}], events)["flags_good"]["value"] is None


def test_intervals_come_from_whole_events():
    rows, events = rows_of(0.3, 0.3)
    for row in rows[: N_EVENTS // 2]:
        row["body_mm"] = 1.0
    for row in rows[N_EVENTS // 2 :]:
        row["body_mm"] = 0.0
    alone = figures(rows, events)["body_mm"]
    many = figures([row for row in rows for _ in range(4)], events)["body_mm"]
    # Four layouts that say the same are no more evidence than one.
    assert many == alone
    assert alone["high"] - alone["low"] == pytest.approx(2 * 1.96 * 0.5 / np.sqrt(N_EVENTS), rel=0.2)


def test_registrations_without_an_answer_are_counted_but_not_scored():
    rows, events = rows_of(0.3, 0.3)
    failed = {"body": "beam", "event": 0, "layout": "far", "seconds": 0.1, "error": "ConvergenceError: none"}
    found = figures([*rows, failed], events)
    assert found["n"]["value"] == N_EVENTS + 1
    assert found["body_mm"]["value"] == figures(rows, events)["body_mm"]["value"]
