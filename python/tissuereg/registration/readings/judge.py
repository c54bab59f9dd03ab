"""Detection of misread marker input from geometry: `suspect` examines the markers and returns suspicions."""

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.readings.frames import columns, frames, units
from tissuereg.registration.readings.likelihood import nowhere_likelihood, standoff, unrelated_likelihood
from tissuereg.registration.readings.orders import orders
from tissuereg.registration.readings.reading import Given, as_given
from tissuereg.registration.readings.repeats import repeated, stale
from tissuereg.registration.readings.rigid import measured_moved, places_moved
from tissuereg.registration.readings.settings import CHECKS, COSTS
from tissuereg.registration.readings.weigh import chosen_rows, weigh
from tissuereg.registration.readings.words import Suspicion, explained, far, held, unrelated
from tissuereg.registration.readings.words import repeated as said_twice
from tissuereg.registration.readings.words import stale as said_stale


def suspect(mesh: Mesh, markers: Markers, observation: MarkerObservation | None = None) -> list[Suspicion]:
    """Return suspicions that the input is misread, from the geometry of the markers, with the best other reading.

    Parameters
    ----------
    mesh : Mesh
        Undeformed body, mm; its node set ``fixed``, if it has one, is held.
    markers : Markers
        Reference and measured places as they were given, in mm if they are right; coordinates that are NaN were not
        seen.
    observation : MarkerObservation, optional
        Map from nodes to these markers, of which the distances from the surface are used; by default they are computed
        here (the map refuses markers that are far away).

    Returns
    -------
    list of Suspicion
        The suspicion that another reading is right comes first; the list is empty if the input is plausible.

    Notes
    -----
    No mechanics is involved: about 250 readings (interpretations of the input, with other units, axes, rigid motions,
    columns or orders of rows), each with prior odds, are compared by distances from the surface and smoothness of the
    motion. A reading is reported if it is a thousand times more likely than the input as given. Readings that leave
    distances and motion unchanged cannot be distinguished, such as two negated axes of a round body. Cost: about 25 ms
    for 15 markers on 4,000 nodes; of more than 48 markers 48 are used.

    Examples
    --------
    >>> import numpy as np
    >>> from tissuereg import Markers, Mesh
    >>> from tissuereg.registration.readings import suspect
    >>> mesh = Mesh([[0, 0, 0], [90, 0, 0], [0, 90, 0], [0, 0, 90]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> places = np.array([[30.0, 30, 30], [10, 0, 60], [0, 15, 40], [60, 0, 20], [0, 55, 30], [20, 45, 25]])
    >>> suspect(mesh, Markers(places, places + 0.5))
    []
    >>> suspect(mesh, Markers(places / 10, (places + 0.5) / 10))[0].kind
    'unit'
    """
    given = Given.of(mesh, markers, np.arange(len(markers)))
    near = given.skin.closest(markers.reference)
    distance = near.distance if observation is None else np.copysign(observation.distance, near.distance)
    resting = near.held & (np.abs(distance) <= standoff(mesh.extent))
    found, left = _repeats(markers, resting, mesh.extent)
    kept = np.flatnonzero(left)
    read = _other_reading(given if len(kept) == len(markers) else Given.of(mesh, markers, kept)) if len(kept) else []
    if not read:
        read = _lost(markers, distance, mesh.extent) + _slipped(markers, resting, mesh.extent)
    return read + found


def _repeats(markers: Markers, resting: BoolArray, extent: float) -> tuple[list[Suspicion], BoolArray]:
    """Return suspicions of stale markers and of markers listed twice, and a mask (n_markers,) of the other markers.

    A stale marker has the same measured and reference place; of two equal markers the first stays in the mask.
    `resting` bool (n_markers,): markers on the held part of the surface; `extent`: largest extent of the body along an
    axis, mm.
    """
    found: list[Suspicion] = []
    left = np.ones(len(markers), dtype=bool)
    rows = stale(markers, resting)
    if rows:
        found.append(said_stale([markers.names[i] for i in rows]))
        left[rows] = False
    for first, second, what in repeated(markers, extent):
        found.append(said_twice((markers.names[first], markers.names[second]), what))
        left[second] = False
    return found, left


def _other_reading(given: Given) -> list[Suspicion]:
    """Return the suspicion that another reading (interpretation) of the input is right, or that no reading is.

    Result: a list with one suspicion if one is far more probable than the input as given; otherwise empty.
    """
    rows = chosen_rows(given)
    readings = [as_given(given), *units(given), *frames(given), *columns(given)]
    readings += [*measured_moved(given), *orders(given)]
    distance, near = given.skin.closest(given.reference).distance, CHECKS.near_share * given.skin.extent
    # Places that all lie inside the body were placed there on purpose; a rigid motion would have moved some outside.
    if float(np.mean(distance**2)) > near**2 and float(np.max(distance)) > 0.5 * near:
        readings += places_moved(given)
    plain, *others = weigh(given, readings, rows)
    extent = given.skin.extent
    others = [weighed for weighed in others if weighed.total > plain.total and weighed.believable(extent)]
    best = max(others, key=lambda weighed: weighed.total, default=plain)
    nowhere = plain.of_layout + plain.of_motion + nowhere_likelihood(plain.distance, extent) - COSTS.far
    apart = plain.of_layout + plain.of_places + unrelated_likelihood(plain.motion, extent) - COSTS.unrelated
    if max(best.total, nowhere, apart) < plain.total + COSTS.margin:
        return []
    if best is not plain and best.total >= max(nowhere, apart):
        return [explained(plain, best, others, given.names)]
    if nowhere >= apart:
        return [far([given.names[i] for i in rows], np.abs(plain.distance).tolist(), extent)]
    return [unrelated(plain.motion)]


def _lost(markers: Markers, distance: FloatArray, extent: float) -> list[Suspicion]:
    """Return the suspicion that markers lie farther above the surface than any marker is plausibly mounted.

    `distance` (n_markers,): signed distance of the reference places from the surface, negative inside, mm; `extent`:
    largest extent of the body along an axis, mm. Result: a list with at most one suspicion.
    """
    outside = 1.5 * standoff(extent) + 0.03 * extent + 4.0 * markers.std
    rows = np.flatnonzero(distance > outside)
    return [far([markers.names[i] for i in rows], np.abs(distance[rows]).tolist(), extent)] if len(rows) else []


def _slipped(markers: Markers, resting: BoolArray, extent: float) -> list[Suspicion]:
    """Return the suspicion that markers on the held part of the surface move.

    `resting` bool (n_markers,): markers on that part; `extent`: largest extent of the body along an axis, mm. Result: a
    list with at most one suspicion.
    """
    seen = np.where(np.isfinite(markers.displacement), markers.displacement, 0.0)
    size = np.linalg.norm(seen, axis=1)
    rows = np.flatnonzero(resting & (size > max(CHECKS.held_mm, CHECKS.held_share * extent) + 4.0 * markers.std))
    return [held([markers.names[i] for i in rows], float(size[rows].max()))] if len(rows) else []
