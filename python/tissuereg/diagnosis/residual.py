"""The residual after the findings: at which markers and pads and at which moment it is largest, and its nearest cause.

Input is the reduced residual of a search (whitened by the null covariance, so that it is white noise of unit variance
where the model holds); output is the entry ``left`` of the answer.
"""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.misfit import Misfit
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search
from tissuereg.diagnosis.signals import SignalLayout

#: Number of markers and pads that are listed at most, and their least root mean square in noise deviations.
MOST_PLACES, ABOVE = 5, 1.3

#: Least log Bayes factor, in nats, with which the residual resembles a cause of the catalogue.
LOOKS_LIKE = 6.0


def residual_summary(layout: SignalLayout, screen: Screen, found: Search, misfit: Misfit) -> dict[str, Any]:
    """Return the description of a residual that is a misfit.

    Parameters
    ----------
    layout : SignalLayout
        Order of the data.
    screen : Screen
        All hypotheses, for the nearest cause.
    found : Search
        Findings and reduced residual.
    misfit : Misfit
        Its misfit test.

    Returns
    -------
    dict
        ``p``, ``where`` (names of markers and pads), ``when``, ``looks_like`` (an id, or ``"unknown"``), ``sentence``.
    """
    where = largest_residuals(layout, found.reduced)
    case, time = worst_frame(layout, found.reduced)
    alike = nearest_cause(screen, found)
    when = f"most at {time:.4g} s, under case {case}"
    places = f"at {', '.join(where)}" if where else "spread over all markers and pads"
    like = "no cause of the catalogue" if alike == UNKNOWN else f"'{alike}' more than any other cause"
    sentence = f"A misfit remains after the findings (p = {misfit.p:.2g}) {places}, {when}; it resembles {like}."
    return {"p": misfit.p, "where": where, "when": when, "looks_like": alike, "sentence": sentence}


def largest_residuals(layout: SignalLayout, reduced: FloatArray) -> list[str]:
    """Return the markers and pads with the largest root mean square residual, the largest first."""
    power: dict[str, float] = {}
    count: dict[str, float] = {}
    seen = layout.seen
    for part in layout.parts:
        rows = [
            (name, part.markers(reduced)[:, i], part.markers(seen)[:, i]) for i, name in enumerate(layout.marker_names)
        ]
        rows += [(name, part.forces(reduced)[:, i], part.forces(seen)[:, i]) for i, name in enumerate(part.pads)]
        for name, values, known in rows:
            power[name] = power.get(name, 0.0) + float((values[known] ** 2).sum())
            count[name] = count.get(name, 0.0) + float(known.sum())
    chi = {name: np.sqrt(power[name] / count[name]) for name in power if count[name]}
    worst = sorted((name for name in chi if chi[name] > ABOVE), key=lambda name: -chi[name])
    return worst[:MOST_PLACES]


def worst_frame(layout: SignalLayout, reduced: FloatArray) -> tuple[str, float]:
    """Return the case and the time of the frame with the largest sum of squared residuals."""
    worst = ("", 0.0, -np.inf)
    for part in layout.parts:
        power = (part.markers(reduced) ** 2).sum(axis=(1, 2)) + (part.forces(reduced) ** 2).sum(axis=(1, 2))
        top = int(np.argmax(power))
        if power[top] > worst[2]:
            worst = (part.name, float(part.times[top]), float(power[top]))
    return worst[:2]


def nearest_cause(screen: Screen, found: Search) -> str:
    """Return the id of the cause with the most evidence in the residual; ``"unknown"`` below `LOOKS_LIKE` nats."""
    gains = {name: one.log_bayes_factor for name, one in screen.of(found.reduced).items()}
    named = set(found.final.ids)
    others = {name: gain for name, gain in gains.items() if name not in named and name != UNKNOWN}
    best = max(others, key=lambda name: others[name], default=UNKNOWN)
    return best if others.get(best, -np.inf) >= LOOKS_LIKE else UNKNOWN
