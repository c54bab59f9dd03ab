"""The reported fit of the findings: the form of each cause and the weights of the rows with the best predictions.

Evidence needs the full noise covariance, with correlated errors along curves. Such weights rely on slopes more than on
levels; where a law is slightly wrong, they may predict worse than equal weights for all rows of a curve. Held-out data
decide between the two, and between the forms of a law; for a single curve, whose last part is no fair test of forms,
the fit itself decides. The weights affect the parameters only: their standard deviations follow from the full noise
covariance and the model error of the form (`deviations`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tissuereg.diagnosis.material.causes import CAUSES, Form
from tissuereg.diagnosis.material.deviations import stated
from tissuereg.diagnosis.material.fit import MaterialFit, fitted
from tissuereg.diagnosis.material.holdout import HeldOutErrors, ProofInput, held_out_errors
from tissuereg.diagnosis.material.hypothesis import Hypothesis
from tissuereg.diagnosis.material.noise import CurveNoise
from tissuereg.diagnosis.material.search import MaterialSearch
from tissuereg.diagnosis.material.weights import weights_of


@dataclass(frozen=True, eq=False)
class Refined:
    """The reported fit of the causes found.

    Attributes
    ----------
    fit : MaterialFit
        Fit to all rows; its covariance includes the model error of its form (the formula of the law).
    held_out : HeldOutErrors
        Errors on held-out data with the same form and weights.
    weighting : {"lasting errors", "rows alike"}
        Weights of the rows: by the full covariance with correlated errors, or equal within a curve.
    form_error : float
        Root mean square of the form's model error, over the stress; NaN until it is estimated.
    """

    fit: MaterialFit
    held_out: HeldOutErrors
    weighting: str
    form_error: float = math.nan


def refined(search: MaterialSearch, none: Hypothesis, known: Hypothesis, noise: CurveNoise) -> Refined:
    """Return the fit of the causes found in the form and with the weights that predict held-out data best.

    `search`: search that found them, with its data; `none`, `known`: the believed law without and with the causes
    found; `noise`: noise of the curves. Result: with one of the forms (formulas) tried of each cause, and its
    deviations.
    """
    benches = {"lasting errors": search.bench, "rows alike": rows_alike(search.bench, noise)}
    if search.bench.unit == "part":
        # In a single curve only the noise model separates correlated errors from memory; other laws need none.
        del benches["rows alike" if known.fit.model.remembers else "lasting errors"]
    best = min((_of(bench, known.fit, name) for name, bench in benches.items()), key=lambda r: _error(search, r))
    for cause in (cause for cause in known.ids if CAUSES[cause].slot == "law"):
        best = _best_form(search, none, replace(known, fit=best.fit), cause, best, benches)
    with_deviations = stated(benches[best.weighting], best.fit)
    return replace(best, fit=with_deviations.fit, form_error=with_deviations.form_error)


def _best_form(
    search: MaterialSearch,
    none: Hypothesis,
    known: Hypothesis,
    cause: str,
    best: Refined,
    benches: dict[str, ProofInput],
) -> Refined:
    place, least = known.ids.index(cause), search.bench.problem.settings.material.worth
    for fit in _in_each_form(search, none, known, cause):
        if fit.forms[place].label == best.fit.forms[place].label:
            continue
        for name, bench in benches.items():
            tried = _of(bench, fit, name)
            simpler = len(fit.x) < len(best.fit.x)
            worth = 1.0 / (1.0 - least) if simpler else 1.0 - least
            if _error(search, tried) < worth * _error(search, best):
                best = tried
    return best


def _in_each_form(search: MaterialSearch, none: Hypothesis, known: Hypothesis, cause: str) -> list[MaterialFit]:
    rest = search.without(none, known, cause)
    fits = search.in_forms(rest, cause)
    order = [*rest.ids, cause]
    return [_reordered(fit, order, known.ids) for fit in fits]


def _reordered(fit: MaterialFit, order: list[str], wanted: tuple[str, ...]) -> MaterialFit:
    """Return a fit whose forms and parameters, now in the order of the ids `order`, are in that of the ids `wanted`."""
    parts: dict[str, tuple[Form, slice]] = {}
    first = 1
    for id, form in zip(order, fit.forms, strict=True):
        parts[id] = form, slice(first, first + len(form.mean))
        first += len(form.mean)
    index = np.concatenate([[0], *(np.arange(len(fit.x))[parts[id][1]] for id in wanted)]).astype(np.int64)
    forms = tuple(parts[id][0] for id in wanted)
    return replace(fit, forms=forms, x=fit.x[index], covariance=fit.covariance[np.ix_(index, index)])


def _of(bench: ProofInput, fit: MaterialFit, weighting: str) -> Refined:
    if weighting == "rows alike":
        fit = fitted(bench.problem, fit.forms, [fit.x])
    return Refined(fit, held_out_errors(bench, fit), weighting)


def _error(search: MaterialSearch, refined: Refined) -> float:
    """Return the error (rms, kPa) that decides between fits: on held-out data, or of the fit for a single curve."""
    if search.bench.unit != "part":
        return refined.held_out.rms_all
    data = search.bench.problem.data
    return float(np.sqrt(np.mean((data.stress - data.modelled(refined.fit.model)) ** 2)))


def rows_alike(bench: ProofInput, noise: CurveNoise) -> ProofInput:
    """Return a bench (data, covariances and folds) on which the rows of a curve have equal weights in fits.

    `bench`: rows, covariances and folds; `noise`: noise of the curves. Result: prediction errors are still measured in
    units of the full noise covariance.
    """
    data = bench.problem.data
    peaks = np.array([float(np.nanmax(np.abs(curve.stress))) for curve in data.curves])
    size = np.maximum(noise.std, bench.problem.settings.material.rows_alike * peaks)[data.curve_of]
    own = np.diag(size**2)
    problem = replace(bench.problem, weights=weights_of(own, np.zeros_like(own)))
    return replace(bench, problem=problem, fitting=own)
