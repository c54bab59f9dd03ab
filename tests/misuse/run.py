"""Ask `tissuereg.readings` about misread and about good events; count what it says."""

from collections.abc import Iterable

import numpy as np

from misuse.events import BODIES, Event, good, misusable
from misuse.misuses import MISUSES, alike
from tissuereg.errors import TissueRegError
from tissuereg.observe import MarkerObservation
from tissuereg.readings import suspect

#: Good events a body, events that a misuse is tried on, events with one marker off; the odd half makes the page.
N_GOOD, N_MISUSED, N_OFF = 200, 8, 40


def answer(event: Event) -> dict:
    """Return what making the input and `suspect` say of an event; `found`: either speaks against it."""
    refused, found = None, []
    try:
        mesh, markers = event.mesh(), event.markers()
        found = suspect(mesh, markers)
        MarkerObservation.of(mesh, markers)
    except TissueRegError as error:
        refused = type(error).__name__
    return {
        "refused": refused,
        "kinds": [s.kind for s in found],
        "sentences": [s.sentence for s in found],
        "found": bool(found) or refused is not None,
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
