"""Unknown loads, a few events of another solver: errors and regions are as in the published table."""

import numpy as np
import pytest
from scipy.stats import chi2

from common import BENCHES, read_archive
from loadfree.run import answer_event
from loadfree.supports import SUPPORTS

#: Body and number of events of the half that was kept for the test: every kind of load, three bodies.
EVENTS = [("beam", 1), ("beam", 7), ("phantom", 3), ("phantom", 9), ("hole", 5), ("hole", 11)]


@pytest.fixture(scope="module")
def rows():
    """Rows of registration, and of no motion, on these events with markers spread over the surface."""
    methods = ("contacts", "none")
    return {
        method: [row for body, number in EVENTS for row in answer_event((method, body, number, ["spread"]))]
        for method in methods
    }


def body_mm(rows):
    return np.array([row["body_mm"] for row in rows])


def published_mm(method):
    kept = read_archive(BENCHES / "loadfree" / "archive" / "test")["rows"][method]
    published = {(row["body"], row["event"]): row for row in kept if row["layout"] == "spread"}
    return body_mm([published[event] for event in EVENTS])


def test_errors_are_those_of_the_table_and_below_those_of_a_spline(rows):
    errors = body_mm(rows["contacts"])
    assert errors.mean() < 1.1 * published_mm("contacts").mean()
    assert errors.mean() < 0.6 * published_mm("spline").mean()
    assert np.all(errors < 0.5 * body_mm(rows["none"]))


def test_regions_hold_their_share_of_the_targets(rows):
    squares = np.array([row["m2"] for row in rows["contacts"]])
    assert 0.85 <= (squares <= chi2.ppf(0.9, 3)).mean() <= 1.0
    # As wide as they must be, not as wide as the motion.
    assert np.median([row["half_axis_um"] for row in rows["contacts"]]) < 0.5e3 * body_mm(rows["none"]).mean()


def test_a_support_that_gives_way_is_found_where_the_user_doubts_it():
    (doubted,), (sure,) = (answer_event((how, "hole", 1, ["spread"]), SUPPORTS) for how in ("perhaps", "sure"))
    assert doubted["body_mm"] < 0.8 * sure["body_mm"]
