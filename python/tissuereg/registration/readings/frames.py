"""Readings (ways to interpret the input) in other units, axes or columns, for all markers or part of their places."""

import itertools

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.reading import Given, Reading
from tissuereg.registration.readings.settings import COSTS

#: Factor that converts a length to mm, and the name of the unit.
UNITS = {
    1000.0: "metres",
    100.0: "decimetres",
    10.0: "centimetres",
    25.4: "inches",
    0.001: "micrometres",
    0.1: "tenths of a mm",
}
#: A mesh in other units needs the inverse factor.
MESH_UNITS = {0.1: "centimetres", 1.0 / 25.4: "inches"}

_ALL, _REFERENCE, _MEASURED = "all markers", "the reference places", "the measured places"


def units(given: Given) -> list[Reading]:
    """Return readings (ways to interpret the input) with lengths in other units, in all places or in a part of them."""
    x, y = given.reference, given.measured
    readings = []
    for factor, name in UNITS.items():
        words = f"if read in {name} (times {factor:g})"
        log_scale = float(np.log(factor))
        readings += [
            Reading("unit", f"{_ALL} {words}", COSTS.unit, factor * x, factor * (y - x), factor * x, log_scale),
            Reading("unit", f"{_REFERENCE} {words}", COSTS.unit + COSTS.alone, factor * x, y - factor * x, factor * x),
            Reading("unit", f"{_MEASURED} {words}", COSTS.unit + COSTS.alone, x, factor * y - x, x, log_scale),
        ]
    for factor, name in MESH_UNITS.items():
        words = f"{_ALL} if the mesh is in {name} (markers times {factor:.3g})"
        log_scale = float(np.log(factor))
        readings.append(Reading("unit", words, COSTS.unit, factor * x, factor * (y - x), factor * x, log_scale))
    return readings


def frames(given: Given) -> list[Reading]:
    """Return readings (ways to interpret the input) with axes negated or exchanged, in all places or in a part."""
    x, y = given.reference, given.measured
    middle, motion = given.skin.middle, given.motion
    readings = []
    for turn, cost, title in signed_permutations():
        back = x @ turn.T
        kind = "mirrored" if np.linalg.det(turn) < 0 and np.count_nonzero(np.diag(turn)) == 3 else "frame"
        words = f"if read as {title}"
        alone = cost + COSTS.alone
        readings += [
            Reading(kind, f"{_ALL} {words}", cost, back, motion, x),
            Reading("frame", f"{_REFERENCE} {words}", alone, back, y - back, back),
            Reading("frame", f"{_MEASURED} {words}", alone, x, y - x @ turn, x @ turn),
        ]
        if kind == "mirrored" and cost == COSTS.flip:
            about = (x - middle) @ turn.T + middle
            words = f"{_ALL} {words} about the body's middle"
            readings.append(Reading(kind, words, cost + COSTS.middle, about, motion, x))
    return readings


def columns(given: Given) -> list[Reading]:
    """Return readings (ways to interpret the input) in which columns or rows of the marker table were shifted by one.

    Such mistakes happen in a spreadsheet. The list is empty unless all markers were seen with all three coordinates.
    """
    if not given.complete.all() or len(given.names) < 2:
        return []
    x, y = given.reference, given.measured
    readings = []
    for step, title in ((1, "right"), (-1, "left")):
        rolled = np.roll(np.concatenate([x, y], axis=1), step, axis=1)
        places, moved = rolled[:, :3], rolled[:, 3:]
        words = f"all markers if the six columns are moved by one to the {title}"
        readings.append(Reading("columns", words, COSTS.column, places, moved - places, places))
    for step, title in ((1, "down"), (-1, "up")):
        for axis, name in enumerate("xyz"):
            moved, places = y.copy(), x.copy()
            moved[:, axis] = np.roll(y[:, axis], step)
            places[:, axis] = np.roll(x[:, axis], step)
            words = f"if their column {name} is moved {title} by one row"
            readings += [
                Reading("columns", f"{_MEASURED} {words}", COSTS.column + 1.0, x, moved - x, x),
                Reading("columns", f"{_REFERENCE} {words}", COSTS.column + 1.0, places, y - places, places),
            ]
    return readings


def signed_permutations() -> list[tuple[FloatArray, float, str]]:
    """Return the 47 matrices (3, 3) that exchange and negate axes, each with its prior cost and its words.

    True places are the matrix times the given places; the cost is minus the logarithm of the prior odds of this
    mistake.
    """
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            negated = signs.count(-1.0)
            if order == (0, 1, 2) and negated == 0:
                continue
            cheap = order == (0, 1, 2) and (negated == 1 or signs == (-1.0, -1.0, 1.0))
            title = ", ".join(("-" if sign < 0 else "") + "xyz"[axis] for sign, axis in zip(signs, order, strict=True))
            found.append((turn, COSTS.flip if cheap else COSTS.axes, f"({title})"))
    return found
