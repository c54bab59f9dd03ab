"""Repeated numbers that real measurements do not give: stale poses and markers that are listed twice.

Two coordinates agree bit for bit by chance with probability ``q / (sqrt(4 pi) sigma)`` if the file keeps steps of
q mm and the noise is sigma; a finding is reported if that probability is below one in a thousand.
"""

import itertools
from math import lgamma, log, pi, sqrt

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.body.markers import Markers
from tissuereg.registration.readings.settings import CHECKS, COSTS


def stale(markers: Markers, resting: BoolArray) -> list[int]:
    """Return the numbers of the markers whose measured places equal their reference places bit for bit, beyond chance.

    `markers`: reference and measured places, mm; `resting` bool (n_markers,): markers on the held part of the surface,
    which may be at rest.
    """
    seen = np.isfinite(markers.measured)
    same = (seen.any(axis=1) & ((markers.measured == markers.reference) | ~seen).all(axis=1)) & ~resting
    found = np.flatnonzero(same)
    if not len(found):
        return []
    steps = _step(markers)
    chance = np.minimum(steps / (sqrt(4.0 * pi) * markers.std[found]), 1.0)
    odds = -float(np.sum(seen[found].sum(axis=1) * np.log(chance)))
    n = len(markers)
    choices = lgamma(n + 1) - lgamma(len(found) + 1) - lgamma(n - len(found) + 1)
    return [int(i) for i in found] if odds - choices > COSTS.margin else []


def repeated(markers: Markers, extent: float) -> list[tuple[int, int, str]]:
    """Return pairs of markers, by number, whose "reference", "measured" or "both" places are equal beyond chance."""
    n = len(markers)
    chance = (_step(markers) / (0.3 * extent)) ** 2 * max(n * (n - 1) / 2, 1.0)
    if n < 2 or -log(chance) < COSTS.margin:
        return []
    found = {}
    for what, places in (("reference", markers.reference), ("measured", markers.measured)):
        groups: dict[bytes, list[int]] = {}
        for row in np.flatnonzero(np.isfinite(places).all(axis=1)):
            groups.setdefault((places[row] + 0.0).tobytes(), []).append(int(row))
        for group in groups.values():
            for pair in itertools.pairwise(group):
                found[pair] = "both" if pair in found else what
    return [(i, j, what) for (i, j), what in sorted(found.items())]


def _step(markers: Markers) -> float:
    """Return the step of all coordinates of the markers, reference and measured, mm; see `step_of`."""
    return step_of(np.concatenate([markers.reference, markers.measured]))


def step_of(places: FloatArray) -> float:
    """Return the coarsest step of 10, 1, 0.1, ... mm of which all coordinates are multiples; at least `finest_mm`.

    `places` (n, 3): mm; NaN is ignored.
    """
    values = places[np.isfinite(places)]
    step = 10.0
    while step > CHECKS.finest_mm * 1.5:
        if np.all(np.abs(values / step - np.round(values / step)) < 1e-7 * np.maximum(np.abs(values / step), 1.0)):
            return step
        step /= 10.0
    return CHECKS.finest_mm
