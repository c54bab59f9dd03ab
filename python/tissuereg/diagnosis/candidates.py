"""Candidates of a round of the search, and the revision of causes that were found one after another.

Candidates are the causes with enough linear evidence given the current model. Each is fitted nonlinearly over its
likeliest hypothesis and the alternatives to it, with the discretisation error of the cause corrected (`refined`). In
the revision each cause is exchanged for those that came close to it, as later ones were missing from the model then.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import catalogue
from tissuereg.diagnosis.fit import Fit, FitTarget, FittedCause, Near, best_start, choices_of, fit, near_to
from tissuereg.diagnosis.refined import correctable, corrected_fit
from tissuereg.diagnosis.screen import UNKNOWN, Screen, Screened
from tissuereg.experiment.effects import EFFECTS


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that was fitted together with the causes found in earlier rounds.

    `fit`: fit of the model with this cause, as the last, and those found before; `gain`: log Bayes factor of that model
    against the one without this cause, nats; `target`: what was fitted; for likely candidates the discretisation error
    of the causes is corrected in it.
    """

    id: str
    fit: Fit
    gain: float
    target: FitTarget

    def as_rival(self) -> tuple[FittedCause, FloatArray]:
        """Return the cause with its fitted free parameters (k,), to be tried in place of another cause."""
        return self.fit.parts[-1], self.fit.x[self.fit.slices()[-1]]


def refitted(
    target: FitTarget, screen: Screen, screened: Mapping[str, Screened], current: Fit, required: Mapping[str, float]
) -> list[Candidate]:
    """Return the causes with enough linear evidence, each fitted with those found before, likeliest first.

    For candidates that come near to acceptance the discretisation error of the causes is corrected. `screened`: linear
    evidence given the fit `current` with the causes found before, by id; `required`: log Bayes factor that each cause
    must exceed, nats, by id.
    """
    settings = target.bench.settings
    used = {UNKNOWN, *(name for name in current.ids if not _repeats(name, settings.search.repeated))}
    others = (name for name in screened if name not in used)
    order = sorted(others, key=lambda name: -screened[name].log_bayes_factor)
    best = screened[order[0]].log_bayes_factor if order else -np.inf
    # Given a fitted cause, residuals are small and the linear evidence is close to that of a fit.
    likely = settings.search.likely_further if current.parts else settings.search.likely
    chosen = [
        name
        for rank, name in enumerate(order)
        if screened[name].log_bayes_factor > likely * required[name]
        and (rank < settings.search.refitted or screened[name].log_bayes_factor > best - settings.search.within)
    ]
    if not chosen:
        return []
    fits: dict[str, list[Fit]] = {}
    near = near_to(target, current)

    def fitted_forms(name: str) -> list[Fit]:
        """Return the fits of a cause, which end early where that of the likeliest is out of reach."""
        best = max((forms[0].log_evidence for forms in fits.values()), default=-np.inf)
        # Less than required suffices to be in the group of another cause.
        enough = current.log_evidence + required[name] - settings.as_likely_within
        enough -= _correction_gain(target, (*current.ids, name))
        least = max(best - settings.model.correction_gain, enough)
        return _fit_forms(target, screen, screened[name], current, name, least, near)

    for names in (chosen[:1], chosen[1:]):
        if names:
            target.bench.progress(f"fit {' + '.join([*current.ids, ' or '.join(names)])}")
        made = target.bench.side_by_side(fitted_forms, names)
        fits.update((name, forms) for name, forms in zip(names, made, strict=True) if forms)
    top = max((forms[0].log_evidence for forms in fits.values()), default=-np.inf)
    found = []
    for name, forms in fits.items():
        # Uncorrected, a fit may lose the evidence seen in screening: friction on a coarse mesh slips too far elsewhere.
        least = top - settings.model.correction_gain
        if screened[name].log_bayes_factor < required[name]:
            least = max(least, current.log_evidence + likely * required[name])
        corrected = (corrected_fit(target, form) for form in forms if form.log_evidence > least)
        own, fitted = max(corrected, key=lambda pair: pair[1].log_evidence, default=(target, forms[0]))
        found.append(Candidate(name, fitted, fitted.log_evidence - current.log_evidence, own))
    return sorted(found, key=lambda candidate: -candidate.gain)


def _fit_forms(
    target: FitTarget, screen: Screen, screened: Screened, current: Fit, name: str, least: float, near: Near
) -> list[Fit]:
    """Return the fits of a cause from its likeliest hypothesis and the alternatives to it, likeliest first."""
    variant = screened.best
    assert variant is not None  # only the generic rival has none
    cause = catalogue(target.bench.settings)[name]
    alternatives = cause.alternatives(target.bench, variant)
    choices = choices_of(name, screen.bank[name]) * (1 + len(alternatives))
    gain = _correction_gain(target, (*current.ids, name))
    fits: list[Fit] = []
    best = -np.inf
    for form in (variant, *alternatives):
        free_parameters = cause.free_parameters(target.bench, form, screened.amplitudes)
        parts = [*current.parts, FittedCause(name, free_parameters)]
        start = best_start(target, parts, near)
        # A fit ends early where the correction of its discretisation error could not make it likelier than the best.
        enough = max(least, best - gain)
        fitted = fit(target, parts, start=start, choices=choices, least=enough, near=near)
        if fitted is not None:
            fits.append(fitted)
            best = max(best, fitted.log_evidence)
    return sorted(fits, key=lambda fitted: -fitted.log_evidence)


def _repeats(name: str, repeated: Collection[str] | None) -> bool:
    return EFFECTS[name].repeatable if repeated is None else name in repeated


def without(target: FitTarget, current: Fit, part: int) -> Fit | None:
    """Return the fit of a model without the cause of number `part`; None where there is no equilibrium."""
    mine = np.r_[current.slices()[part]]
    others = [*current.parts[:part], *current.parts[part + 1 :]]
    near = Near(np.delete(current.x, mine), np.delete(current.jacobian, mine, axis=0))
    return fit(target, others, near=near) or fit(target, others)


def exchanged(
    target: FitTarget, current: Fit, part: int, rivals: Sequence[tuple[FittedCause, FloatArray]]
) -> tuple[FitTarget, Fit]:
    """Return the fit with the best of some rivals in place of one cause, where that gains `better` nats.

    The discretisation error of the causes is corrected in every fit. `part`: number of the cause in the fit `current`;
    `rivals`: other causes, each with the free parameters (k,) at which its fit begins. Result: target and fit; the
    given ones where no rival is better.
    """
    mine = current.slices()[part]
    best, of_best = current, target
    for rival, free_parameters in rivals:
        parts = [*current.parts[:part], rival, *current.parts[part + 1 :]]
        start = np.concatenate([current.x[: mine.start], free_parameters, current.x[mine.stop :]])
        least = max(best.log_evidence, current.log_evidence + target.bench.settings.search.better)
        before = least - _correction_gain(target, [cause.id for cause in parts])
        fitted = fit(target, parts, start=start, least=before)
        if fitted is not None and fitted.log_evidence >= before:
            better, again = corrected_fit(target, fitted)
            if again.log_evidence > least:
                of_best, best = better, again
    return of_best, best


def _correction_gain(target: FitTarget, ids: Sequence[str]) -> float:
    """Return the nats that a correction of the discretisation error may add to a fit with causes of these ids."""
    return target.bench.settings.model.correction_gain if correctable(target, ids) else 0.0
