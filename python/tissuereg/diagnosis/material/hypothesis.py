"""Hypotheses: a set of causes, each in one of its forms, with or without a generic misfit in addition.

The evidence of a hypothesis is the mean over the forms tried and over the sizes of a generic misfit (a Gaussian process
that no cause explains), with prior weights.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES, FreeParameters
from tissuereg.diagnosis.fit import FittedCause
from tissuereg.diagnosis.material.fit import FitProblem, MaterialFit, fitted
from tissuereg.diagnosis.material.noise import weights_of


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of causes, fitted together, each in one form (formula of a law or effect with fitted parameters).

    `ids`: ids of the causes in the order of their discovery; empty for the believed model; `fit`: fit in the best
    forms; `evidence`: log evidence, averaged over the forms tried and over the sizes of a generic misfit; `forms`: fits
    with the newest cause in each form tried, likeliest first.
    """

    ids: tuple[str, ...]
    fit: MaterialFit
    evidence: float
    forms: tuple[MaterialFit, ...] = ()


def null_hypothesis(problem: FitProblem) -> Hypothesis:
    """Return the fitted null hypothesis: the believed law holds, with Young's modulus within its prior."""
    fit = fitted(problem, (), [np.array([problem.young_log])])
    return Hypothesis((), fit, fit.evidence)


def plain_fit(problem: FitProblem, noise: FloatArray) -> MaterialFit:
    """Return a fit of the believed law that treats all rows as independent, the usual practice.

    `problem`: data, weights and believed model; `noise` (n, n): covariance of the rows, kPa^2, of which only the
    diagonal is used. Result: its evidence cannot be compared with that of a hypothesis.
    """
    weights = weights_of(np.diag(np.diag(noise)), np.zeros_like(noise))
    return fitted(replace(problem, weights=weights), (), [np.array([problem.young_log])])


def unknown(problem: FitProblem, known: Hypothesis) -> Hypothesis:
    """Return the generic rival of all causes: those found so far, and a smooth misfit that no cause explains.

    `problem`: data, weights and believed model; `known`: causes found so far. Result: with the fit of the likeliest
    size of the misfit (a Gaussian process), and the log evidence averaged over all sizes; the last of its ids is
    ``unknown``.
    """
    shares = problem.settings.material.misfit_shares
    fits = [fitted(problem, known.fit.parts, [known.fit.x], share) for share in shares]
    best = max(fits, key=lambda fit: fit.evidence)
    evidence = float(np.logaddexp.reduce([fit.evidence for fit in fits])) - math.log(len(shares))
    return Hypothesis((*known.ids, "unknown"), best, evidence)


def with_cause(problem: FitProblem, known: Hypothesis, cause: str, forms: Sequence[FreeParameters]) -> Hypothesis:
    """Return the hypothesis with one more cause, in its best form.

    `problem`: data, weights and believed model; `known`: causes found so far; their forms are kept, their parameters
    are fitted again; `cause`: id of the new cause; `forms`: formulas in which it is tried, at least one. Result: its
    log evidence is averaged over the forms.
    """
    found: list[tuple[MaterialFit, float]] = []
    # The fit of a simpler form gives a first guess for a richer one.
    x = known.fit.x
    for form in forms:
        starts = [np.concatenate([x, start]) for start in form.guesses]
        starts += [np.concatenate([x, *more]) for more in _grown(form, found)]
        found.append(refitted(problem, (*known.fit.parts, FittedCause(cause, form)), starts))
    # Of forms with about the same evidence, that with the fewest parameters.
    highest = max(pair[1] for pair in found)
    as_good = [pair for pair in found if pair[1] >= highest - problem.settings.material.simpler]
    best = min(as_good, key=lambda pair: (len(pair[0].x), -pair[1]))
    evidence = float(np.logaddexp.reduce([pair[1] for pair in found])) - math.log(len(forms))
    ordered = sorted(found, key=lambda pair: -pair[1])
    return Hypothesis((*known.ids, cause), best[0], evidence, tuple(fit for fit, _ in ordered))


def refitted(
    problem: FitProblem, parts: Sequence[FittedCause], starts: Sequence[FloatArray]
) -> tuple[MaterialFit, float]:
    """Return a fit of causes in given forms, with or without a generic misfit, and the log evidence of these forms.

    `problem`: data, weights and believed model; `parts`: the causes; `starts`: first guesses. Result: `fit`:
    the likelier of the two; `evidence`: log of the mean evidence with and without the generic misfit, weighted by their
    prior probabilities.
    """
    numbers = problem.settings.material
    none = numbers.no_misfit
    plain = fitted(problem, parts, starts)
    share = _likeliest_share(problem, plain)
    small = math.log((1.0 - none) / len(numbers.misfit_shares))
    if share == 0.0:
        return plain, plain.evidence + math.log(none)
    smooth = fitted(problem, parts, [plain.x], share)
    evidence = float(np.logaddexp(plain.evidence + math.log(none), smooth.evidence + small))
    return (smooth if smooth.evidence + small > plain.evidence + math.log(none) else plain), evidence


def excluded(cause: str, known: Sequence[str]) -> bool:
    """Return whether a cause cannot stand beside those found, given by their ids: it is one, or another law."""
    return cause in known or (CAUSES[cause].is_law and any(CAUSES[other].is_law for other in known))


def _likeliest_share(problem: FitProblem, fit: MaterialFit) -> float:
    residual = problem.data.stress - problem.data.modelled(fit.model)
    shares, none = problem.settings.material.misfit_shares, problem.settings.material.no_misfit

    def score(share: float) -> float:
        white = problem.weights.whitened(residual, share)
        prior = none if share == 0.0 else (1.0 - none) / len(shares)
        return -0.5 * float(white @ white) - problem.weights.log_size(share) + math.log(prior)

    return max((0.0, *shares), key=score)


def _grown(form: FreeParameters, found: Sequence[tuple[MaterialFit, float]]) -> list[list[FloatArray]]:
    """Return first guesses for a Prony series from the fitted one with one term less.

    `form`: form of the series, else the list is empty; `found`: fits of the same cause in earlier forms, with their
    evidence. A guess has two arrays, each (n_terms,): parameters of the shares, and log times in s.
    """
    if not found or not form.label.startswith("prony"):
        return []
    last = found[-1][0]
    n = len(form.mean) // 2
    numbers = last.x[len(last.x) - 2 * (n - 1) :]
    shares, times = numbers[: n - 1], numbers[n - 1 :]
    ends = (times.min() - 1.5, times.max() + 1.5)
    return [[np.append(shares, -1.5), np.append(times, new)] for new in ends]
