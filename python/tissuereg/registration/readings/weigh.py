"""Comparison of readings (ways to interpret the input): a cheap likelihood for all, that of the motion for some."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.registration.readings.likelihood import (
    layout_likelihood,
    likeliest,
    motion_likelihood,
    nowhere_likelihood,
    places_likelihood,
    unrelated_likelihood,
)
from tissuereg.registration.readings.orders import oddness
from tissuereg.registration.readings.reading import Given, Reading
from tissuereg.registration.readings.rigid import best_rigid, moved
from tissuereg.registration.readings.settings import COSTS, PROPOSALS


@dataclass(frozen=True, eq=False)
class Weighed:
    """A reading (one interpretation of the input) with its log-likelihoods, without constants that all readings share.

    `reading`: the reading; `distance` (n_weighed,): signed distances of the reference places of the markers used from
    the surface, mm; `motion` (n_weighed, 3): their displacements, mm, without the rigid motion of a free body;
    `of_layout`, `of_places`, `of_motion`: log-likelihoods of the layout on the body, of the distances from its surface,
    and of the displacements.
    """

    reading: Reading
    distance: FloatArray
    motion: FloatArray
    of_layout: float
    of_places: float
    of_motion: float

    @property
    def total(self) -> float:
        """Log-odds of the reading, log-likelihoods minus prior cost, up to a constant that readings share."""
        return self.of_layout + self.of_places + self.of_motion - self.reading.cost

    def believable(self, extent: float) -> bool:
        """Return whether places and motion are more probable than ones unrelated to the body (of this extent, mm)."""
        places = self.of_places > nowhere_likelihood(self.distance, extent)
        n_seen = int(np.isfinite(self.motion).sum())
        motion = self.of_motion - n_seen * self.reading.log_scale
        return places and motion > unrelated_likelihood(self.motion, extent)


def chosen_rows(given: Given) -> IntArray:
    """Return the numbers of the markers to use: all, or, of many, some spread over the body and the unusual ones."""
    n = len(given.names)
    if n <= PROPOSALS.spread_markers + PROPOSALS.odd_markers:
        return np.arange(n)
    rows = np.flatnonzero(given.complete)
    odd = rows[np.argsort(-oddness(given.reference[rows], given.measured[rows]))[: PROPOSALS.odd_markers]]
    taken = list(odd) or [0]
    gap = np.min([np.linalg.norm(given.reference - given.reference[i], axis=1) for i in taken], axis=0)
    while len(taken) < PROPOSALS.spread_markers + PROPOSALS.odd_markers:
        taken.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(given.reference - given.reference[taken[-1]], axis=1))
    return np.unique(taken)


def weigh(given: Given, readings: list[Reading], rows: IntArray) -> list[Weighed]:
    """Return the promising readings (interpretations of the input) with their log-likelihoods.

    `given`: the input; `readings`: candidates, the input as given first; `rows` int64 (n_weighed,): numbers of the
    markers that are used. Result: the input as given is first.
    """
    where: dict[int, int] = {}
    stacked: list[FloatArray] = []
    for reading in readings:
        if id(reading.places) not in where:
            where[id(reading.places)] = len(stacked)
            stacked.append(reading.places[rows])
    places = np.array(stacked)
    near = given.skin.closest(places)
    distance = near.distance
    layout = layout_likelihood(places, near.held, given.skin.spread)
    of_places = places_likelihood(distance, given.skin.extent)
    likely = layout + of_places
    index = [where[id(reading.places)] for reading in readings]
    same, others = _worth(readings, likely[index], rows)
    found: list[Weighed] = []
    for group in _groups(readings, same) + _groups(readings, others):
        if found and _hopeless(found[0], readings[group[0]], float(likely[index[group[0]]]), given, rows):
            continue
        motion, odds = _motion(given, [readings[i] for i in group], rows)
        found += [
            Weighed(
                readings[i],
                distance[index[i]],
                motion[j],
                float(layout[index[i]]),
                float(of_places[index[i]]),
                float(odds[j]),
            )
            for j, i in enumerate(group)
        ]
    return found


def _worth(readings: list[Reading], likely: FloatArray, rows: IntArray) -> tuple[list[int], list[int]]:
    """Return which readings are evaluated in full: two lists of their numbers.

    `readings`: interpretations of the input, the input as given first; `likely` (n_readings,): log-likelihood of each
    reading's places; `rows`: numbers of the markers used. The first list has the readings with the given places and
    axes, the second the likeliest of the others. Readings with only the measured places in other axes are kept if the
    motion becomes smaller.
    """
    given = readings[0]
    same, turned, elsewhere = [0], [], []
    for number, reading in enumerate(readings[1:], 1):
        if reading.places is not given.places:
            elsewhere.append(number)
        elif reading.arms is given.arms or reading.rigid:
            same.append(number)
        else:
            turned.append(number)
    size = _sizes([readings[i] for i in (0, *turned)], rows)
    smaller = [turned[i] for i in np.argsort(size[1:], kind="stable") if size[1 + i] < size[0]]
    elsewhere.sort(key=lambda i: readings[i].cost - likely[i])
    return same, [*smaller[: PROPOSALS.turned], *elsewhere[: PROPOSALS.places]]


def _hopeless(plain: Weighed, reading: Reading, likely: float, given: Given, rows: IntArray) -> bool:
    """Return whether a reading cannot be more probable than the input as given, however well its motion fits.

    `plain`: the input as given, with its likelihood; `likely`: log-likelihood of the reading's places; `rows`: numbers
    of the markers used. If the motion is unchanged, the places decide; otherwise the bound is the likelihood of no
    motion at all.
    """
    if reading.motion is plain.reading.motion:
        return likely - reading.cost < plain.of_layout + plain.of_places + COSTS.margin
    values = reading.motion[rows]
    n_seen = int(np.isfinite(values).sum())
    best = n_seen * (reading.log_scale + likeliest(given.noise))
    return likely + best - reading.cost < plain.total + COSTS.margin


def _sizes(readings: list[Reading], rows: IntArray) -> FloatArray:
    """Return the median absolute seen coordinate of the displacements under each reading, (n_readings,), mm."""
    motion = np.abs([reading.motion[rows] for reading in readings])
    seen = np.isfinite(motion[0])
    return np.median(motion[:, seen], axis=1) if seen.any() else np.zeros(len(readings))


def _groups(readings: list[Reading], chosen: list[int]) -> list[list[int]]:
    """Return the numbers of the `chosen` readings (interpretations of the input) by equal places and frame."""
    groups: dict[tuple[int, int, bool], list[int]] = {}
    for number in chosen:
        reading = readings[number]
        groups.setdefault((id(reading.places), id(reading.arms), reading.rigid), []).append(number)
    return list(groups.values())


def _motion(given: Given, readings: Sequence[Reading], rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return displacements (n_readings, n_weighed, 3), mm, of the markers, and their log-likelihoods (n_readings,).

    `readings`: interpretations of the input that share places and frame; `rows`: numbers of the markers used. For a
    free body the best rigid motion is removed from the displacements.
    """
    arms, freedom = readings[0].arms[rows], given.skin.freedom(readings[0].places[rows])
    motion = np.array([reading.motion[rows] for reading in readings])
    free = not len(given.held_nodes)
    whole = np.isfinite(motion[0]).all(axis=1)
    if free and whole.sum() >= 3:
        ends = arms + motion
        turn, shift = best_rigid(np.broadcast_to(arms[whole], ends[:, whole].shape), ends[:, whole])
        motion = ends - moved(arms, turn, shift)
    scales = int(np.isfinite(motion[0]).sum()) * np.array([reading.log_scale for reading in readings])
    whole_body = free or readings[0].rigid
    odds = motion_likelihood(arms, freedom, motion, given.noise, given.skin.extent, rigid=whole_body)
    return motion, scales + odds
