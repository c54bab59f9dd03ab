"""Readings (ways to interpret the input) with rows of measured places exchanged, moved by one, sorted or matched."""

import itertools
from math import lgamma, log

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.registration.readings.reading import Given, Reading
from tissuereg.registration.readings.rigid import best_rigid, moved
from tissuereg.registration.readings.settings import COSTS, PROPOSALS


def orders(given: Given) -> list[Reading]:
    """Return readings (ways to interpret the input) in which the rows of the measured places are in another order.

    Markers with missing coordinates stay as they are.
    """
    rows = np.flatnonzero(given.complete)
    if len(rows) < 2:
        return []
    x, y = given.reference[rows], given.measured[rows]
    tried = [*_pairs(x, y), *_rolls(x, y, [given.names[i] for i in rows]), *_matches(x, y)]
    candidates, costs = np.array([order for order, _ in tried]), np.array([cost for _, cost in tried])
    smooth = np.median(y - x, axis=0)
    size = np.linalg.norm(y[candidates] - x - smooth, axis=2).sum(axis=1)
    size += 1e6 * (candidates == np.arange(len(rows))).all(axis=1)
    best = np.argsort(size, kind="stable")[: PROPOSALS.orders]
    return [_reading(given, rows, candidates[i], costs[i]) for i in best if size[i] < 1e6]


def _reading(given: Given, rows: IntArray, order: IntArray, cost: float) -> Reading:
    measured = given.measured.copy()
    measured[rows] = given.measured[rows[order]]
    changed = rows[order != np.arange(len(order))]
    names = [given.names[i] for i in changed]
    what = f"{names[0]} and {names[1]} are exchanged" if len(names) == 2 else f"{len(names)} rows are put in order"
    words = f"the measured places if {what}"
    return Reading(
        "swapped",
        words,
        cost,
        given.reference,
        measured - given.reference,
        given.reference,
        rows=tuple(int(i) for i in changed),
    )


def _pairs(x: FloatArray, y: FloatArray) -> list[tuple[IntArray, float]]:
    """Return orders in which two rows are exchanged, each with its prior cost.

    `x`, `y` (n, 3): reference and measured places, mm. Result: for each order the row numbers of `y`, int64 (n,), and
    minus the logarithm of the prior odds.
    """
    n = len(x)
    tried = np.arange(n) if n <= PROPOSALS.all_pairs else np.sort(np.argsort(oddness(x, y))[-PROPOSALS.all_pairs :])
    cost = COSTS.swap + log(n * (n - 1) / 2)
    found = []
    for i, j in itertools.combinations(tried, 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        found.append((order, cost))
    return found


def _rolls(x: FloatArray, y: FloatArray, names: list[str]) -> list[tuple[IntArray, float]]:
    """Return orders that a table may have by mistake: shifted by some rows, reversed, sorted by name or coordinate.

    `x`, `y` (n, 3): reference and measured places, mm; `names`: names of the n markers. Result: for each order the row
    numbers of `y`, int64 (n,), and minus the logarithm of the prior odds.
    """
    n = len(x)
    found = [np.roll(np.arange(n), step) for step in (1, -1, 2, -2)] + [np.arange(n)[::-1].copy()]
    listed = np.array(sorted(range(n), key=lambda i: names[i]))
    found += [listed, np.argsort(listed)]
    for axis in range(3):
        # If the measured rows were sorted by a coordinate, their order is that of the reference along it.
        order = np.empty(n, np.int64)
        order[np.argsort(x[:, axis], kind="stable")] = np.argsort(y[:, axis], kind="stable")
        found.append(order)
    return [(order, COSTS.order + log(n)) for order in found]


def _matches(x: FloatArray, y: FloatArray) -> list[tuple[IntArray, float]]:
    """Return the orders of least total motion of the markers, and each of their cycles alone, with their prior costs.

    `x`, `y` (n, 3): reference and measured places, mm. The motion is measured from the reference places, and also from
    those after the best rigid motion. Result: for each order the row numbers of `y`, int64 (n,), and minus the
    logarithm of the prior odds.
    """
    from scipy.optimize import linear_sum_assignment

    n = len(x)
    starts = [x]
    if n >= 4:
        turn, shift = best_rigid(x, y)
        starts.append(moved(x, turn, shift))
    found = []
    for start in starts:
        gaps = np.linalg.norm(start[:, None] - y[None], axis=2)
        order = np.asarray(linear_sum_assignment(gaps)[1], np.int64)
        changed = int((order != np.arange(n)).sum())
        found.append((order, COSTS.swap + lgamma(n + 1) - lgamma(n - changed + 1)))
        for cycle in _cycles(order):
            one = np.arange(n)
            one[cycle] = order[cycle]
            found.append((one, COSTS.swap + lgamma(n + 1) - lgamma(n - len(cycle) + 1) - log(len(cycle))))
    return found


def _cycles(order: IntArray) -> list[list[int]]:
    left, cycles = set(range(len(order))), []
    while left:
        cycle, at = [], min(left)
        while at in left:
            left.discard(at)
            cycle.append(at)
            at = int(order[at])
        if len(cycle) > 1:
            cycles.append(cycle)
    return cycles


def oddness(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return how far every marker's displacement differs from the median of its neighbours', (n,), mm.

    `x`, `y` (n, 3): reference and measured places, mm.
    """
    from scipy.spatial import cKDTree

    neighbours = np.asarray(cKDTree(x).query(x, k=min(PROPOSALS.neighbours + 1, len(x)))[1])[:, 1:]
    motion = y - x
    return np.asarray(np.linalg.norm(motion - np.median(motion[neighbours], axis=1), axis=1))
