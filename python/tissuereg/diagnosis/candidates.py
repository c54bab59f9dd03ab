"""Candidates of one round of the search: causes with enough linear evidence, fitted nonlinearly and corrected.

Input is the screening of all causes given the current model; output, for each candidate, its best fit over its
likeliest hypothesis and the alternatives to it, with the discretisation error of the cause corrected (`refined`), and
its log Bayes factor.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES, catalogue
from tissuereg.diagnosis.fit import Fit, FitTarget, FittedCause, best_start, choices_of, fit
from tissuereg.diagnosis.refined import corrected_fit
from tissuereg.diagnosis.screen import UNKNOWN, Screen, Screened
from tissuereg.diagnosis.settings import DEFAULT, SearchSettings
from tissuereg.experiment.effects import EFFECTS


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that was fitted together with the causes found in earlier rounds.

    `id`: id of the cause; `fit`: fit of the model with this cause, as the last, and those found before; `gain`: log
    Bayes factor of that model against the one without this cause, nats; `target`: the data and the believed model that
    were fitted; for likely candidates the discretisation error of the causes is corrected in it.
    """

    id: str
    fit: Fit
    gain: float
    target: FitTarget

    def as_rival(self) -> tuple[FittedCause, FloatArray]:
        """Return the cause with its fitted free parameters (k,), to be tried in place of another cause."""
        return self.fit.parts[-1], self.fit.x[self.fit.slices()[-1]]


def refitted(
    target: FitTarget,
    screen: Screen,
    screened: Mapping[str, Screened],
    current: Fit,
    required: Mapping[str, float],
) -> list[Candidate]:
    """Return the causes with enough linear evidence, each fitted with those found before, likeliest first.

    For candidates that come near to acceptance the discretisation error of the causes is corrected. `target`: data,
    believed model, noise and nuisances; `screen`: all hypotheses of the bank; `screened`: linear evidence of all causes
    given the current fit, by id; `current`: fit with the causes found before; `required`: log Bayes factor that each
    cause must exceed, nats, by id.
    """
    settings = target.bench.settings
    taken = set(current.ids)
    order = sorted(
        (
            name
            for name in screened
            if name != UNKNOWN and (name not in taken or _repeats(name, settings.search.repeated))
        ),
        key=lambda name: -screened[name].log_bayes_factor,
    )
    best = screened[order[0]].log_bayes_factor if order else -np.inf
    # Given a fitted cause, residuals are small and the linear evidence is close to that of a fit.
    likely = settings.search.likely_further if current.parts else settings.search.likely
    chosen = [
        name
        for rank, name in enumerate(order)
        if screened[name].log_bayes_factor > likely * required[name]
        and (rank < settings.search.refitted or screened[name].log_bayes_factor > best - settings.search.within)
    ]
    fits: dict[str, list[Fit]] = {}
    for name in chosen:
        target.bench.progress(f"fit {' + '.join([*current.ids, name])}")
        best_fit = max((forms[0].log_evidence for forms in fits.values()), default=-np.inf)
        least = max(best_fit - settings.model.correction_gain, current.log_evidence + required[name])
        forms = _fit_forms(target, screen, screened[name], current, name, least)
        if forms:
            fits[name] = forms
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


def required_thresholds(
    thresholds: Mapping[str, float], found: Iterable[str] = (), settings: SearchSettings = DEFAULT.search
) -> dict[str, float]:
    """Return the log Bayes factor, in nats, that each cause must exceed, by id, given the causes found before.

    `thresholds`: log Bayes factors required of a first cause, nats, by id; `found`: ids of the causes found before.
    Unless these are only errors of the marker tracker, more is required of a further cause.
    """
    if all(CAUSES[name].closed_form for name in found):
        return dict(thresholds)
    return {name: max(settings.further * least, settings.least_further) for name, least in thresholds.items()}


def _fit_forms(
    target: FitTarget, screen: Screen, screened: Screened, current: Fit, name: str, least: float
) -> list[Fit]:
    """Return the fits of a cause, from its likeliest hypothesis and from the alternatives to it, likeliest first.

    `screened`: linear evidence of the cause; `current`: fit with the causes found before; `name`: id of the cause. A
    fit ends early where it will not reach the log evidence `least`, in nats, or where the correction of its
    discretisation error could not make it likelier than the best one.
    """
    variant = screened.best
    assert variant is not None  # only the generic rival has none
    cause = catalogue(target.bench.settings)[name]
    alternatives = cause.alternatives(target.bench, variant)
    choices = choices_of(name, screen.bank[name]) * (1 + len(alternatives))
    gain = target.bench.settings.model.correction_gain
    fits: list[Fit] = []
    best = -np.inf
    for form in (variant, *alternatives):
        free_parameters = cause.free_parameters(target.bench, form, screened.amplitudes)
        parts = [*current.parts, FittedCause(name, free_parameters)]
        start = best_start(target, parts, current.x)
        fitted = fit(target, parts, start=start, choices=choices, hopeless=-max(least, best - gain))
        if fitted is not None:
            fits.append(fitted)
            best = max(best, fitted.log_evidence)
    return sorted(fits, key=lambda fitted: -fitted.log_evidence)


def _repeats(name: str, repeated: Collection[str] | None) -> bool:
    return EFFECTS[name].repeatable if repeated is None else name in repeated
