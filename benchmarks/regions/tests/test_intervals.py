"""Do intervals by clusters hold?"""

import numpy as np
import pytest
from scipy.stats import betabinom

from common import read_archive
from regions.cases import body_of
from regions.intervals import interval
from regions.regions import ARCHIVE, page


@pytest.mark.parametrize(("mean", "correlation"), [(0.5, 0.1), (0.9, 0.02), (0.9, 0.1)])
def test_intervals_of_five_clusters_hold_the_share_that_made_them(mean, correlation):
    rng, size = np.random.default_rng(3), 1.0 / correlation - 1.0
    held, n_trials = 0, 40
    for _ in range(n_trials):
        shares = rng.beta(mean * size, (1.0 - mean) * size, 5)
        low, high = interval(tuple((int(rng.binomial(480, share)), 480) for share in shares))
        held += low <= mean <= high
    # 95 % of 40, less three standard deviations of that number.
    assert held >= 34


@pytest.mark.parametrize("share", [0.95, 0.5])
@pytest.mark.parametrize(
    "counts", [((9, 10), (7, 10), (10, 10)), ((470, 480), (480, 480), (400, 480)), ((30, 30),) * 5]
)
def test_an_interval_is_that_of_the_law_on_an_even_grid(counts, share):
    means, correlations = (np.arange(1000) + 0.5) / 1000, (np.arange(100) + 0.5) / 100
    size = 1.0 / correlations - 1.0
    a, b = means[:, None] * size, (1.0 - means)[:, None] * size
    logs = sum(betabinom.logpmf(inside, n, a, b) for inside, n in counts)
    weights = np.exp(logs - logs.max()).sum(axis=1)
    below = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    wanted = np.interp([0.5 - share / 2, 0.5 + share / 2], below, means)
    # Both grids are of steps of up to 0.0075 in between which they are linear.
    assert interval(counts, share) == pytest.approx(wanted, abs=1e-3)


def test_an_interval_shrinks_with_clusters_and_not_with_targets_of_one():
    def width(counts):
        low, high = interval(counts)
        return high - low

    assert width(((90, 100),) * 12) < 0.6 * width(((90, 100),) * 4)
    assert width(((9000, 10000),)) > 0.9 * width(((90, 100),))
    # All inside is no proof that all will be.
    assert interval(((300, 300),) * 5)[0] < 0.99


def test_cases_of_a_body_are_one_cluster_of_the_page():
    answer = read_archive(ARCHIVE)
    named = {row["family"]: set() for row in answer["rows"]}
    for row in answer["rows"]:
        named[row["family"]].add(body_of(row["cluster"]))
    lines = page(answer).splitlines()
    for family, bodies in named.items():
        [line] = [line for line in lines if line.startswith(f"| {family} |")]
        cells = line.split(" | ")
        assert cells[1] == str(len(bodies))
        assert all((" to " in cell) == (len(bodies) > 1) for cell in cells[5:8])
    assert named["reference problems"] == {"dome_4k"}
    assert len(named["five bodies, markers far"]) == 5
