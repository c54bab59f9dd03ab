"""Detection of misread surface points, and of markers on another body, by distances from the undeformed surface."""

from itertools import permutations, product

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.registration.readings.likelihood import standoff
from tissuereg.registration.readings.settings import CHECKS, CLOUDS
from tissuereg.registration.readings.skin import Skin, skin_of
from tissuereg.registration.readings.words import Suspicion

#: Units that lengths may be in by mistake, with the factor that converts them to millimetres.
_UNITS = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4, "micrometres": 0.001}


def suspect_points(mesh: Mesh, points: FloatArray, *, free: bool) -> list[Suspicion]:
    """Return the suspicion that measured points of a surface are misread, such as in another unit or other axes.

    `mesh`: undeformed body, mm; `points` (n, 3): measured places as they were given, in mm if they are right; `free`:
    whether the body may have moved rigidly: only another unit can then be recognised, by the size of the cloud. Result:
    a list with at most one suspicion; empty if the input is plausible.
    """
    few = points[:: max(1, len(points) // CLOUDS.points)]
    ratio = float(np.max(np.ptp(points, axis=0))) / mesh.extent
    if free:
        return [_size(ratio)] if not CLOUDS.smaller <= ratio <= CLOUDS.larger else []
    skin = skin_of(mesh)
    typical = _typical(skin, few)
    if typical <= CLOUDS.odd * mesh.extent:
        return []
    others = [(f"in {unit}, not millimetres", "unit", factor * few) for unit, factor in _UNITS.items()]
    others += [(f"with the axes ({words})", "frame", turned) for words, turned in _turned(few)]
    found = min(((_typical(skin, places), kind, words) for words, kind, places in others), key=lambda one: one[0])
    if found[0] * CLOUDS.times < typical and found[0] < CLOUDS.near * mesh.extent:
        text = (
            f"{found[1]}: the surface points lie typically {typical:.1f} mm from the undeformed surface; read "
            f"{found[2]}, they would lie {found[0]:.1f} mm from it"
        )
        return [Suspicion(found[1], text)]
    if typical > CLOUDS.lost * mesh.extent:
        text = (
            f"far from the surface: the surface points lie typically {typical:.1f} mm from a body of extent "
            f"{mesh.extent:.1f} mm"
        )
        return [Suspicion("far from the surface", text)]
    return []


def _typical(skin: Skin, points: FloatArray) -> float:
    return float(np.median(np.abs(skin.closest(points).distance)))


def _turned(points: FloatArray) -> list[tuple[str, FloatArray]]:
    """Return the points (n, 3), mm, with axes exchanged and negated in 47 ways, each with words such as "y, -x, z"."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            if order == (0, 1, 2) and signs == (1.0, 1.0, 1.0):
                continue
            words = ", ".join(
                f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)
            )
            found.append((words, points[:, order] * np.array(signs)))
    return found


def _size(ratio: float) -> Suspicion:
    """Return the suspicion that points are in other units; `ratio`: extent of the points over that of the body."""
    unit = min(_UNITS, key=lambda name: abs(np.log(ratio * _UNITS[name])))
    text = f"unit: the surface points span {ratio:.3g} times the extent of the body; they may be in {unit}"
    return Suspicion("unit", text)


def scattered(distance: FloatArray, extent: float) -> list[Suspicion]:
    """Return the suspicion that the reference places of markers are those on another body.

    `distance` (n_markers,): signed distances of the reference places from the surface, negative inside, mm; `extent`:
    largest extent of the body along an axis, mm. Result: a list with at most one suspicion. There is one where three
    assumptions are all improbable by chi-squares of the distances: that all markers were mounted on the surface at one
    height, each with an error; that all were placed inside the body; and that those below the surface were, and all
    others mounted at one height with a small error.
    """
    from scipy.stats import chi2

    n = len(distance)
    if n < CHECKS.fewest:
        return []
    height = float(np.clip(distance.mean(), 0.0, standoff(extent)))
    mounted = np.sum((distance - height) ** 2) / (CHECKS.mounted * standoff(extent)) ** 2
    fine = CHECKS.inside_mm + CHECKS.inside_share * extent
    inside = np.sum(np.maximum(distance, 0.0) ** 2) / fine**2
    skin = distance[distance > -2.0 * fine]
    some = np.sum((skin - np.clip(skin.mean(), 0.0, standoff(extent))) ** 2) / fine**2 if len(skin) else 0.0
    chances = (chi2.sf(mounted, n - 1), chi2.sf(inside, n), chi2.sf(some, max(len(skin) - 1, 1)))
    if max(chances) >= CHECKS.level:
        return []
    low, high = float(distance.min()), float(distance.max())
    text = (
        f"places: the markers lie from {-min(low, 0.0):.1f} mm below the surface of the undeformed body to "
        f"{max(high, 0.0):.1f} mm above it; they may be those of another body"
    )
    return [Suspicion("places", text)]
