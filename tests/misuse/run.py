"""Ask `tissuereg.readings` about misread and about good events; count what it says."""

import time
from collections.abc import Iterable

import numpy as np

from misuse.events import BODIES, Event, good, misusable
from misuse.misuses import MISUSES, alike
from tissuereg.errors import TissueRegError
from tissuereg.observe import MarkerObservation
from tissuereg.readings import suspect

#: Numbers of good events a body, and of events that a misuse is tried on; the odd ones make the page.
N_GOOD, N_MISUSED = 200, 8


def answer(event: Event) -> dict:
    """Return what reading the input, and the suspicion where it can be read, say of an event."""
    told: dict = {"refused": None, "kinds": [], "sentences": []}
    try:
        mesh, markers = event.mesh(), event.markers()
    except TissueRegError as error:
        return {**told, "refused": type(error).__name__, "sentences": [str(error)], "ms": 0.0}
    try:
        observation = MarkerObservation.of(mesh, markers)
    except TissueRegError as error:
        observation, told["refused"] = None, type(error).__name__
    started = time.perf_counter()
    found = suspect(mesh, markers, observation)
    milliseconds = 1000 * (time.perf_counter() - started)
    return {
        **told,
        "kinds": [s.kind for s in found],
        "sentences": [s.sentence for s in found],
        "ms": round(milliseconds, 1),
    }


def misuses(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for every misuse, body and event number."""
    rows = []
    for index, misuse in enumerate(MISUSES):
        for body in BODIES:
            for number in numbers:
                rng = np.random.default_rng([22, 2, index, BODIES.index(body), number])
                before = misusable(body, number)
                after = misuse.change(before, rng)
                told = answer(after)
                named = bool(misuse.named & set(told["kinds"])) or told["refused"] == "UnitError"
                rows.append(
                    {
                        "misuse": misuse.title,
                        "body": body,
                        "event": number,
                        "alike": alike(before, after),
                        "named": named,
                        "found": bool(told["kinds"]) or told["refused"] is not None,
                        **told,
                    }
                )
    return rows


def good_events(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for every body and event number."""
    return [
        {"body": body, "event": number, **answer(event), "n_markers": len(event.reference)}
        for body in BODIES
        for number in numbers
        for event in [good(body, number)]
    ]


def one_marker_off(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for events with one marker 5 mm off, which is for the mechanics to find."""
    rows = []
    for body in BODIES:
        for number in numbers:
            event = misusable(body, number)
            rng = np.random.default_rng([22, 3, BODIES.index(body), number])
            measured = event.measured.copy()
            step = rng.standard_normal(3)
            measured[rng.integers(len(measured))] += 5.0 * step / np.linalg.norm(step)
            rows.append({"body": body, "event": number, **answer(event.but(measured=measured))})
    return rows
