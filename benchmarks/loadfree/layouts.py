"""Where fifteen markers sit: spread, at random, near the contacts or far from them; and what a tracker sees."""

import numpy as np

from loadfree.events import BODIES, Body, Event
from tissuereg import Markers

LAYOUTS = ("spread", "random", "near", "far")
N_MARKERS = 15
NOISE_MM = 0.1


def chosen(body: Body, event: Event, layout: str, count: int = N_MARKERS) -> np.ndarray:
    """Return the places of the pool (count,) that carry markers.

    ``near`` and ``far`` are spread over the third of the pool that is nearest to the contacts, or farthest from them.
    """
    rng = _rng(event, layout, 0)
    distance = np.linalg.norm(body.pool[:, None] - event.centres, axis=2).min(axis=1)
    order = np.argsort(distance, kind="stable")
    third = len(order) // 3
    if layout == "random":
        return rng.choice(len(order), size=count, replace=False)
    among = {"spread": order, "near": order[:third], "far": order[-third:]}[layout]
    return among[farthest(body.pool[among], count, rng)]


def markers(body: Body, event: Event, layout: str) -> Markers:
    """Return what is measured: true places of the markers plus normal noise of `NOISE_MM` a component."""
    places = chosen(body, event, layout)
    noise = NOISE_MM * _rng(event, layout, 1).normal(size=(len(places), 3))
    reference = body.pool[places]
    return Markers(reference, reference + event.pool[places] + noise, std=NOISE_MM)


def farthest(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return points, each the farthest from those before it; the first at random."""
    found = [int(rng.integers(len(points)))]
    nearest = np.full(len(points), np.inf)
    while len(found) < count:
        nearest = np.minimum(nearest, np.linalg.norm(points - points[found[-1]], axis=1))
        found.append(int(nearest.argmax()))
    return np.array(found)


def _rng(event: Event, layout: str, what: int) -> np.random.Generator:
    return np.random.default_rng([2212, BODIES.index(event.body), event.number, LAYOUTS.index(layout), what])
