"""Revision of causes that were found one after another: redundant ones are removed, rivals are tried in their place.

The first cause was accepted while the later ones were still missing from the model. Each cause is therefore removed
again, and stays removed if the evidence falls by less than its threshold; then it is exchanged for the candidates that
came close to it in its round.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.fit import Fit, FitTarget, FittedCause, fit
from tissuereg.diagnosis.refined import corrected_fit


def without(target: FitTarget, current: Fit, part: int, *, hopeless: float = np.inf) -> Fit | None:
    """Return the fit of a model without one of its causes; None where there is no equilibrium.

    `target`: data, believed model, noise and nuisances; `current`: fit with all causes; `part`: number of the cause
    that is removed; `hopeless`: objective, in nats, above which a fit is of no use and ends early.
    """
    mine = current.slices()[part]
    others = [*current.parts[:part], *current.parts[part + 1 :]]
    start = np.delete(current.x, np.r_[mine])
    return fit(target, others, start=start, hopeless=hopeless) or fit(target, others, hopeless=hopeless)


def without_redundant(
    target: FitTarget, current: Fit, thresholds: Mapping[str, float]
) -> tuple[FitTarget, Fit, list[int]]:
    """Return the fit without redundant causes: those whose removal costs less evidence than their threshold.

    The discretisation error of the causes is corrected in every fit. `target`: data, believed model, noise and
    nuisances; `current`: fit with all causes; `thresholds`: log Bayes factor required of every cause, nats, by id.
    Result: target and fit of the causes that stay, and their numbers among the causes of `current`; one at least.
    """
    kept = list(range(len(current.parts)))
    while len(kept) > 1:
        redundant: list[tuple[int, FitTarget, Fit]] = []
        for number, name in enumerate(current.ids):
            # The log evidence at which a fit shows that the cause it lacks is redundant.
            least = current.log_evidence - thresholds[name]
            reached = _reaching(
                least,
                target,
                without(target, current, number, hopeless=target.bench.settings.model.correction_gain - least),
            )
            if reached is not None:
                redundant.append((number, *reached))
        if not redundant:
            break
        # Where either of two causes suffices, the likelier one stays, whatever their thresholds are.
        number, target, current = max(redundant, key=lambda row: row[2].log_evidence)
        del kept[number]
    return target, current, kept


def exchanged(
    target: FitTarget, current: Fit, part: int, rivals: Sequence[tuple[FittedCause, FloatArray]]
) -> tuple[FitTarget, Fit]:
    """Return the fit with the best of some rivals in place of one cause, where that gains `better` nats.

    The discretisation error of the causes is corrected in every fit. `target`: data, believed model, noise and
    nuisances; `current`: fit with all causes; `part`: number of the cause that may be replaced; `rivals`: other causes,
    each with the free parameters (k,) at which its fit begins. Result: target and fit; the given ones where no rival is
    better.
    """
    mine = current.slices()[part]
    best, of_best = current, target
    for rival, free_parameters in rivals:
        parts = [*current.parts[:part], rival, *current.parts[part + 1 :]]
        start = np.concatenate([current.x[: mine.start], free_parameters, current.x[mine.stop :]])
        least = max(best.log_evidence, current.log_evidence + target.bench.settings.search.better)
        reached = _reaching(
            least, target, fit(target, parts, start=start, hopeless=target.bench.settings.model.correction_gain - least)
        )
        if reached is not None:
            of_best, best = reached
    return of_best, best


def _reaching(least: float, target: FitTarget, fitted: Fit | None) -> tuple[FitTarget, Fit] | None:
    """Return target and fit with the discretisation error corrected, if the log evidence exceeds `least` nats.

    Return None otherwise, and where there is no fit.
    """
    if fitted is None or fitted.log_evidence < least - target.bench.settings.model.correction_gain:
        return None
    better, again = corrected_fit(target, fitted)
    return (better, again) if again.log_evidence > least else None
