"""What findings leave unexplained: where and when it stands out, and what it looks like."""

from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.misfit import Misfit
from tissuereg.diagnose.screen import UNKNOWN, Screen
from tissuereg.diagnose.search import Search
from tissuereg.diagnose.signals import Layout

#: Markers and pads that are told at most, and how far above the noise they lie.
MOST_PLACES, ABOVE = 5, 1.3

#: Nats below which what is left looks like nothing of the catalogue.
LOOKS_LIKE = 6.0


def left_of(layout: Layout, screen: Screen, found: Search, misfit: Misfit) -> dict[str, Any]:
    """Return what the findings of a search do not explain.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    screen : Screen
        All hypotheses, for what it looks like.
    found : Search
        With its findings, and what they leave.
    misfit : Misfit
        How unlike noise that is.

    Returns
    -------
    dict
        ``p``, ``where`` (names of markers and pads), ``when``, ``looks_like`` (an id, or ``"unknown"``), ``sentence``.
    """
    where = worst_places(layout, found.reduced)
    case, time = moment(layout, found.reduced)
    alike = looks_like(screen, found)
    when = f"most at {time:.4g} s, under case {case}"
    said = f"at {', '.join(where)}" if where else "everywhere a little"
    like = "like nothing of the catalogue" if alike == UNKNOWN else f"like '{alike}' more than like anything else"
    sentence = f"The findings leave a misfit (p = {misfit.p:.2g}) {said}, {when}; it looks {like}."
    return {"p": misfit.p, "where": where, "when": when, "looks_like": alike, "sentence": sentence}


def worst_places(layout: Layout, reduced: FloatArray) -> list[str]:
    """Return the markers and pads at which most is left, the worst first."""
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


def moment(layout: Layout, reduced: FloatArray) -> tuple[str, float]:
    """Return the case and the time of the frame in which most is left."""
    worst = ("", 0.0, -np.inf)
    for part in layout.parts:
        power = (part.markers(reduced) ** 2).sum(axis=(1, 2)) + (part.forces(reduced) ** 2).sum(axis=(1, 2))
        top = int(np.argmax(power))
        if power[top] > worst[2]:
            worst = (part.name, float(part.times[top]), float(power[top]))
    return worst[:2]


def looks_like(screen: Screen, found: Search) -> str:
    """Return the id of the cause that what is left looks like most; the generic rival's where none does."""
    gains = {name: one.log_bayes_factor for name, one in screen.of(found.reduced).items()}
    named = set(found.final.ids)
    others = {name: gain for name, gain in gains.items() if name not in named and name != UNKNOWN}
    best = max(others, key=lambda name: others[name], default=UNKNOWN)
    return best if others.get(best, -np.inf) >= LOOKS_LIKE else UNKNOWN
