"""Measured places that are no measurements: what a tracker or a file writes for a marker that was not seen.

No list of such values is kept. A measurement has noise, so that digits agree by chance only: three coordinates that are
zero, or equal up to their signs, are no measurement if the chance of it is below one in a thousand, whatever the motion
of the marker; nor is a place that no body of this size can bring a marker to, while most markers say otherwise.
"""

from math import e, exp, hypot, pi, sqrt

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.markers import Markers
from tissuereg.registration.readings.repeats import step_of
from tissuereg.registration.readings.settings import CHECKS, COSTS


def lost(markers: Markers, extent: float) -> dict[str, str]:
    """Return the markers whose measured places are no measurements, by name, each with the reason.

    `markers`: reference and measured places, mm; `extent`: largest extent of the body along an axis, mm.
    """
    found: dict[int, str] = {}
    moved = np.where(np.isfinite(markers.measured), markers.displacement, 0.0)
    rows = np.flatnonzero(markers.seen)
    limit = exp(-COSTS.margin) / max(len(rows), 1)
    for row in rows[np.ptp(np.abs(markers.measured[rows]), axis=1) == 0.0]:
        place, size = markers.measured[row], hypot(*moved[row])
        if size <= CHECKS.at_rest * sqrt(3.0) * markers.std[row]:
            continue  # a plausible place: where the marker was
        # No Gaussian law of the motion has a larger density per axis at a motion of this size.
        density = exp(-0.5) / (sqrt(2.0 * pi) * size / sqrt(3.0))
        step = _step(markers)
        if not place.any() and (density * step) ** 3 < limit:
            found[int(row)] = "lost: measured at exactly 0, 0, 0"
        elif 4.0 * (density * step) ** 2 < limit:
            found[int(row)] = f"lost: the same number along every axis, {abs(place[0]):g}"
    found |= {row: why for row, why in _away(markers, extent).items() if row not in found}
    found |= {row: why for row, why in _together(markers, extent).items() if row not in found}
    return {markers.names[row]: why for row, why in sorted(found.items())}


def _step(markers: Markers) -> float:
    """Return the step of the measured places, mm, by those whose numbers tell it, or else by the reference places."""
    places, times = np.unique(markers.measured[markers.seen], axis=0, return_counts=True)
    telling = places[(times == 1) & (np.ptp(np.abs(places), axis=1) > 0.0)]
    return step_of(telling if len(telling) else markers.reference)


def _away(markers: Markers, extent: float) -> dict[int, str]:
    """Return the numbers of the markers that moved farther from the middle of all than any body of this extent, mm."""
    moved = markers.displacement
    if int(np.isfinite(moved).any(axis=1).sum()) < CHECKS.fewest_moving:
        return {}
    middle = np.array([np.median(along[np.isfinite(along)]) if np.isfinite(along).any() else 0.0 for along in moved.T])
    apart = np.nan_to_num(np.abs(moved - middle), nan=0.0).max(axis=1)
    rows = np.flatnonzero(apart > CHECKS.farthest * extent + 6.0 * markers.std)
    # If most are there, the input is in another unit or frame.
    if 2 * len(rows) >= int(np.isfinite(moved).any(axis=1).sum()):
        return {}
    times = f"{CHECKS.farthest:g} times the body's extent"
    return {int(row): f"lost: more than {times} from where the others say" for row in rows}


def _together(markers: Markers, extent: float) -> dict[int, str]:
    """Return the numbers of three or more markers with other reference places at one measured place, to the digit."""
    rows = np.flatnonzero(markers.seen)
    groups: dict[bytes, list[int]] = {}
    for row in rows:
        groups.setdefault((markers.measured[row] + 0.0).tobytes(), []).append(int(row))
    large = [group for group in groups.values() if len(group) >= CHECKS.fewest_together]
    if not large or len(rows) ** 2 * (_step(markers) / (0.3 * extent)) ** 2 >= exp(-COSTS.margin):
        return {}
    found: dict[int, str] = {}
    for group in large:
        if len(np.unique(markers.reference[group], axis=0)) >= CHECKS.fewest_together:
            found |= dict.fromkeys(group, f"lost: one place for {len(group)} markers, to the last digit")
    return found


def repeated_poses(before: FloatArray, now: FloatArray) -> list[int]:
    """Return the numbers of the markers whose places are those of the frame before to the digit, while others move.

    `before`, `now` (n_markers, 3): measured places, mm; NaN = not seen.
    """
    rows = np.flatnonzero(np.isfinite(before).all(axis=1) & np.isfinite(now).all(axis=1))
    if not len(rows):
        return []
    change = np.linalg.norm(now[rows] - before[rows], axis=1)
    typical = float(np.median(change))
    step = step_of(np.concatenate([before[rows], now[rows]]))
    # The chance that a marker which moves like the others is found where it was.
    same = rows[change == 0.0]
    if (
        not len(same)
        or typical == 0.0
        or len(rows) * (step * sqrt(3.0 / (2.0 * pi * e)) / typical) ** 3 >= exp(-COSTS.margin)
    ):
        return []
    return [int(row) for row in same]
