"""Run `tissuereg.registration.readings`, and then `register`, on misread and on good events; count their answers."""

from collections.abc import Iterable, Iterator

import numpy as np

import tissuereg as tr
from misuse.events import BODIES, Event, good, misusable
from misuse.misuses import MISUSES, alike
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import TissueRegError
from tissuereg.parallel import Failed, Processes, in_order
from tissuereg.registration.readings import suspect

#: Good events a body, events that a misuse is tried on, events with one marker off; the odd half makes the page.
N_GOOD, N_MISUSED, N_OFF = 200, 8, 40


def answer(event: Event) -> dict:
    """Return the answer of constructing the input and of `suspect` for an event; `found`: either objects."""
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


def misused(numbers: Iterable[int]) -> Iterator[tuple[dict, frozenset[str], Event]]:
    """Yield every misuse of every body and event number: what it is, kinds that name it, the event after it."""
    for index, misuse in enumerate(MISUSES):
        for body in BODIES:
            for number in numbers:
                rng = np.random.default_rng([22, 2, index, BODIES.index(body), number])
                before = misusable(body, number)
                after = misuse.change(before, rng)
                which = {"misuse": misuse.title, "body": body, "event": number, "alike": alike(before, after)}
                yield which, misuse.named, after


def misuses(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for every misuse, body and event number."""
    rows = []
    for which, names, after in misused(numbers):
        found = answer(after)
        named = bool(names & set(found["kinds"])) or found["refused"] == "UnitError"
        rows.append({**which, "named": named, **found})
    return rows


def registered(event: Event) -> dict:
    """Return whether `register` trusts its answer, its reasons if not, and the markers that it names as wrong."""
    try:
        body = tr.Body(event.mesh(), held="free" if event.fixed is None else "sure")
        result = tr.register(body, event.markers(), settings=tr.RegisterSettings(threads=1))
    except TissueRegError as error:
        return {"trusted": False, "reasons": [f"{type(error).__name__}: {error}"], "wrong": []}
    wrong = [name for name, why in result.markers.dropped if why == "wrong"]
    return {"trusted": bool(result.trust.ok), "reasons": list(result.trust.reasons), "wrong": wrong}


def through_register(answers: dict, jobs: int) -> None:
    """Register every event in which nothing was found, and keep the answer in its row under ``register``.

    Parameters
    ----------
    answers : dict
        Answers of `misuses`, `good_events` and `one_marker_off`; changed in place.
    jobs : int
        Processes side by side.
    """
    rows = [row for row in answers["misuses"] if not row["found"]]
    left = {(row["misuse"], row["body"], row["event"]) for row in rows}
    numbers = sorted({number for *_, number in left})
    events = [event for which, _, event in misused(numbers) if (which["misuse"], which["body"], which["event"]) in left]
    well = [row for row in answers["good"] if not row["found"]]
    events += [good(row["body"], row["event"]) for row in well]
    off = [row for row in answers["one_marker_off"] if not row["found"]]
    events += [marker_off(row["body"], row["event"])[1] for row in off]
    with Processes(jobs) as executor:
        outcomes = in_order(executor.run(registered, events))
        for row, outcome in zip([*rows, *well, *off], outcomes, strict=True):
            if isinstance(outcome, Failed):
                raise outcome.error
            row["register"] = outcome.result


def good_events(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for every body and event number."""
    return [
        {"body": body, "event": number, **answer(event), "n_markers": len(event.reference)}
        for body in BODIES
        for number in numbers
        for event in [good(body, number)]
    ]


def marker_off(body: str, number: int) -> tuple[str, Event]:
    """Return an event with one marker 5 mm off, and that marker's name."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 3, BODIES.index(body), number])
    measured = event.measured.copy()
    step = rng.standard_normal(3)
    marker = int(rng.integers(len(measured)))
    measured[marker] += 5.0 * step / np.linalg.norm(step)
    return event.markers().names[marker], event.but(measured=measured)


def one_marker_off(numbers: Iterable[int]) -> list[dict]:
    """Return an answer for events with one marker 5 mm off, which is for the mechanics to find."""
    cases = [(body, number, *marker_off(body, number)) for body in BODIES for number in numbers]
    return [{"body": body, "event": number, "marker": name, **answer(event)} for body, number, name, event in cases]
