"""The numbers that are handed on: of each cause the form, and of all the weights, that foretell best.

Evidence needs the noise as it is, errors that last along a curve included; such weights trust slopes more than levels,
and where a law is a little wrong they may foretell worse than rows that all count alike. Which of the two, and
which form of a law, held-out data decide; for a lone curve, whose rest is no fair judge of forms, the fit itself.
Weights choose the numbers; their deviations are those of the noise as it is and of the form's own error (`deviations`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tissuereg.diagnose.material.causes import CAUSES, Form
from tissuereg.diagnose.material.deviations import stated
from tissuereg.diagnose.material.fit import Fit, fitted
from tissuereg.diagnose.material.holdout import Bench, HeldOutErrors, held_out_errors
from tissuereg.diagnose.material.hypothesis import Hypothesis
from tissuereg.diagnose.material.noise import Noise
from tissuereg.diagnose.material.search import Search
from tissuereg.diagnose.material.weights import weights_of

#: Noise of a row over the peak of its curve, where all rows of a curve count alike.
_ALIKE = 0.01
#: A form with more numbers, or other weights, must lower the error by this share.
_WORTH = 0.1


@dataclass(frozen=True, eq=False)
class Refined:
    """What is handed on.

    Attributes
    ----------
    fit : Fit
        Of all rows; its covariance carries the error of its form.
    held_out : HeldOutErrors
        Held-out data by the same form and weights.
    weighting : {"lasting errors", "rows alike"}
        Which noise the rows were given.
    form_error : float
        Size of what the form cannot follow, over the stress.
    """

    fit: Fit
    held_out: HeldOutErrors
    weighting: str
    form_error: float = math.nan


def refined(search: Search, none: Hypothesis, known: Hypothesis, noise: Noise) -> Refined:
    """Return the form and the weights that foretell best.

    Parameters
    ----------
    search : Search
        With its bench.
    none, known : Hypothesis
        What is believed, and that with the causes found.
    noise : Noise
        Of the curves.

    Returns
    -------
    Refined
        One of the forms tried of each cause, with its deviations.
    """
    benches = {"lasting errors": search.bench, "rows alike": rows_alike(search.bench, noise)}
    if search.bench.unit == "part":
        # What lasts along a lone curve is told from memory by its noise; a law without memory is no such rival.
        del benches["rows alike" if known.fit.model.remembers else "lasting errors"]
    best = min((_of(bench, known.fit, name) for name, bench in benches.items()), key=lambda r: _error(search, r))
    for cause in (cause for cause in known.ids if CAUSES[cause].slot == "law"):
        best = _best_form(search, none, replace(known, fit=best.fit), cause, best, benches)
    said = stated(benches[best.weighting], best.fit)
    return replace(best, fit=said.fit, form_error=said.form_error)


def _best_form(
    search: Search, none: Hypothesis, known: Hypothesis, cause: str, best: Refined, benches: dict[str, Bench]
) -> Refined:
    place = known.ids.index(cause)
    for fit in _in_each_form(search, none, known, cause):
        if fit.forms[place].label == best.fit.forms[place].label:
            continue
        for name, bench in benches.items():
            tried = _of(bench, fit, name)
            simpler = len(fit.x) < len(best.fit.x)
            worth = 1.0 / (1.0 - _WORTH) if simpler else 1.0 - _WORTH
            if _error(search, tried) < worth * _error(search, best):
                best = tried
    return best


def _in_each_form(search: Search, none: Hypothesis, known: Hypothesis, cause: str) -> list[Fit]:
    rest = search.without(none, known, cause)
    fits = search.in_forms(rest, cause)
    order = [*rest.ids, cause]
    return [_reordered(fit, order, known.ids) for fit in fits]


def _reordered(fit: Fit, order: list[str], wanted: tuple[str, ...]) -> Fit:
    """Return a fit with its forms, and their numbers, in the order of other ids."""
    parts: dict[str, tuple[Form, slice]] = {}
    first = 1
    for id, form in zip(order, fit.forms, strict=True):
        parts[id] = form, slice(first, first + len(form.mean))
        first += len(form.mean)
    index = np.concatenate([[0], *(np.arange(len(fit.x))[parts[id][1]] for id in wanted)]).astype(np.int64)
    forms = tuple(parts[id][0] for id in wanted)
    return replace(fit, forms=forms, x=fit.x[index], covariance=fit.covariance[np.ix_(index, index)])


def _of(bench: Bench, fit: Fit, weighting: str) -> Refined:
    if weighting == "rows alike":
        fit = fitted(bench.problem, fit.forms, [fit.x])
    return Refined(fit, held_out_errors(bench, fit), weighting)


def _error(search: Search, refined: Refined) -> float:
    """Return the error that decides: of held-out data, of the fit itself for a lone curve; kPa."""
    if search.bench.unit != "part":
        return refined.held_out.rms_all
    data = search.bench.problem.data
    return float(np.sqrt(np.mean((data.stress - data.modelled(refined.fit.model)) ** 2)))


def rows_alike(bench: Bench, noise: Noise) -> Bench:
    """Return a bench on which the rows of a curve count alike in fits.

    Parameters
    ----------
    bench : Bench
        Rows, covariances and folds.
    noise : Noise
        Of the curves.

    Returns
    -------
    Bench
        Errors stay counted in units of the true noise.
    """
    data = bench.problem.data
    peaks = np.array([float(np.nanmax(np.abs(curve.stress))) for curve in data.curves])
    size = np.maximum(noise.std, _ALIKE * peaks)[data.curve_of]
    own = np.diag(size**2)
    problem = replace(bench.problem, weights=weights_of(own, np.zeros_like(own)))
    return replace(bench, problem=problem, fitting=own)
