"""Causes that may be it: chosen by their linear evidence, fitted, the mesh's error in them put right."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.fit import Fit, Part, Target, best_start, choices_of, fit
from tissuereg.diagnose.recorrect import PUT_RIGHT, settled
from tissuereg.diagnose.screen import UNKNOWN, Screen, Screened
from tissuereg.effects import EFFECTS, ChainEffect

#: Candidates that are fitted: this many, and all within so many nats of the best.
REFITTED = 4
WITHIN = 10.0

#: Shares of what a cause must pass that its linear evidence must reach to be fitted: alone, and beside others.
LIKELY, LIKELY_FURTHER = 0.4, 0.5

#: Beside a cause that acts on the body a further one must pass this many times its threshold, and so many nats: what
#: was found before has an error of a form unknown. What the tracker does is known exactly.
FURTHER, LEAST_FURTHER = 1.5, 18.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that was fitted beside those found before.

    Attributes
    ----------
    id : str
        Of the cause.
    fit : Fit
        With the causes found before.
    gain : float
        Log Bayes factor against the model before.
    target : Target
        What was fitted; of likely ones with the mesh's error in the causes put right.
    """

    id: str
    fit: Fit
    gain: float
    target: Target

    def as_mate(self) -> tuple[Part, FloatArray]:
        """Return the cause, fitted last, with its knobs."""
        return self.fit.parts[-1], self.fit.x[self.fit.slices()[-1]]


def refitted(
    target: Target,
    screen: Screen,
    screened: Mapping[str, Screened],
    current: Fit,
    asked: Mapping[str, float],
    progress: Callable[[str], None] | None,
) -> list[Candidate]:
    """Return the likeliest causes beside those of a fit, fitted; those that may be it with the mesh's error put right.

    Parameters
    ----------
    target : Target
        What is fitted.
    screen : Screen
        All hypotheses of the bank.
    screened : mapping of str to Screened
        Linear evidence of all causes beside the fit.
    current : Fit
        With the causes found before.
    asked : mapping of str to float
        Nats that every cause must pass.
    progress : callable of str, optional
        Called with what is at work.

    Returns
    -------
    list of Candidate
        Likeliest first.
    """
    taken = set(current.ids)
    order = sorted(
        (name for name in screened if name != UNKNOWN and (name not in taken or _repeats(name))),
        key=lambda name: -screened[name].log_bayes_factor,
    )
    best = screened[order[0]].log_bayes_factor if order else -np.inf
    # Beside a fitted model the linear evidence is nearly that of a fit.
    likely = LIKELY_FURTHER if current.parts else LIKELY
    chosen = [
        name
        for rank, name in enumerate(order)
        if screened[name].log_bayes_factor > likely * asked[name]
        and (rank < REFITTED or screened[name].log_bayes_factor > best - WITHIN)
    ]
    fits: dict[str, list[Fit]] = {}
    for name in chosen:
        if progress is not None:
            progress(f"fit {' + '.join([*current.ids, name])}")
        best_fit = max((forms[0].log_evidence for forms in fits.values()), default=-np.inf)
        least = max(best_fit - PUT_RIGHT, current.log_evidence + asked[name])
        forms = _fit_forms(target, screen, screened[name], current, name, least)
        if forms:
            fits[name] = forms
    top = max((forms[0].log_evidence for forms in fits.values()), default=-np.inf)
    found = []
    for name, forms in fits.items():
        # A fit may lose on the user's mesh what screening saw: friction there lets too much slip in other places.
        seen = screened[name].log_bayes_factor >= asked[name]
        least = top - PUT_RIGHT if seen else max(top - PUT_RIGHT, current.log_evidence + likely * asked[name])
        put_right = (settled(target, form, progress=progress) for form in forms if form.log_evidence > least)
        own, fitted = max(put_right, key=lambda pair: pair[1].log_evidence, default=(target, forms[0]))
        found.append(Candidate(name, fitted, fitted.log_evidence - current.log_evidence, own))
    return sorted(found, key=lambda candidate: -candidate.gain)


def asked_of(thresholds: Mapping[str, float], beside: Iterable[str] = ()) -> dict[str, float]:
    """Return the log Bayes factor that every cause must pass, alone or beside others found before.

    Parameters
    ----------
    thresholds : mapping of str to float
        Alone.
    beside : iterable of str
        Ids of those found before.

    Returns
    -------
    dict of str to float
        Nats.
    """
    if all(issubclass(EFFECTS[name], ChainEffect) for name in beside):
        return dict(thresholds)
    return {name: max(FURTHER * least, LEAST_FURTHER) for name, least in thresholds.items()}


def _fit_forms(target: Target, screen: Screen, screened: Screened, current: Fit, name: str, least: float) -> list[Fit]:
    """Return the fits of a cause's likeliest hypothesis and of the alternatives to it, likeliest first.

    Fits end early that will not reach `least`, a log evidence, or that the mesh's error, put right, makes no likelier
    than the best one.
    """
    variant = screened.best
    assert variant is not None  # only the generic rival has none
    alternatives = CAUSES[name].alternatives(target.bench, variant)
    choices = choices_of(name, screen.bank[name]) * (1 + len(alternatives))
    fits: list[Fit] = []
    best = -np.inf
    for form in (variant, *alternatives):
        knobs = CAUSES[name].knobs(target.bench, form, screened.amplitudes)
        parts = [*current.parts, Part(name, knobs)]
        start = best_start(target, parts, current.x)
        fitted = fit(target, parts, start=start, choices=choices, hopeless=-max(least, best - PUT_RIGHT))
        if fitted is not None:
            fits.append(fitted)
            best = max(best, fitted.log_evidence)
    return sorted(fits, key=lambda fitted: -fitted.log_evidence)


def _repeats(name: str) -> bool:
    return EFFECTS[name].repeatable
