"""The reported fit of the findings: the form of each cause and the weights of the rows with the best predictions.

Evidence needs the full noise covariance, with correlated errors along curves. Such weights rely on slopes more than on
levels; where a law is slightly wrong, they may predict worse than equal weights for all rows of a curve. Held-out data
decide between the two, and between the forms of a law; for a single curve, whose last part is no fair test of forms,
the fit itself decides. The weights affect the parameters only: their standard deviations follow from the full noise
covariance and the model error of the form.

To first order an error `e` of the rows changes the parameters by ``dx = G e``, with ``G = (J^T W J + 1)^-1 J^T W`` in
units of the prior, J the Jacobian and W the weights of the fit. The error itself does not depend on the weights: it is
the noise of the curves, with correlated errors and factors of specimens, plus the model error of the form. The latter
is modelled by the generic misfit (the rival ``unknown``) with an unknown size s:

    cov(x) = sum_s p(s | q) G (noise + s^2 generic) G^T + (J^T W J + 1)^-2

The last term comes from the prior. The posterior p(s | q) of the size is based on the sum q of squared residuals, each
over the variance of its noise; its density under every size is approximated by a Gamma distribution with the exact mean
and variance, corrected for the fitted parameters. The likelihood of the whole residual is not used: it would derive the
size from the residual's roughness, which is far smaller than the model error of a form with the wrong curvature. The
approach follows Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001, on calibration with a model discrepancy.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.material.fit import MaterialFit, fitted, prior_of
from tissuereg.diagnosis.material.holdout import HeldOutErrors, ProofInput, held_out_errors
from tissuereg.diagnosis.material.hypothesis import Hypothesis
from tissuereg.diagnosis.material.noise import weights_of
from tissuereg.diagnosis.material.search import MaterialSearch


@dataclass(frozen=True, eq=False)
class Refined:
    """The reported fit of the causes found.

    `fit`: fit to all rows; its covariance includes the model error of its form (the formula of the law); `held_out`:
    errors on held-out data with the same form and weights; `weighting`: ``lasting errors`` (rows weighted by the full
    covariance with correlated errors) or ``rows alike`` (equally within a curve); `form_error`: root mean square of the
    form's model error, over the stress; NaN until it is estimated.
    """

    fit: MaterialFit
    held_out: HeldOutErrors
    weighting: str
    form_error: float = math.nan


def refined(search: MaterialSearch, known: Hypothesis) -> Refined:
    """Return the fit of the causes found in the form and with the weights that predict held-out data best.

    `search`: search that found them, with its data; `known`: the believed law with the causes found. Result: with one
    of the forms (formulas) tried of each cause, and its deviations.
    """
    benches = {"lasting errors": search.bench, "rows alike": rows_alike(search.bench)}
    if search.bench.unit == "part":
        # In a single curve only the noise model separates correlated errors from memory; other laws need none.
        del benches["rows alike" if known.fit.model.remembers else "lasting errors"]
    best = min((_of(bench, known.fit, name) for name, bench in benches.items()), key=lambda r: _error(search, r))
    for cause in (cause for cause in known.ids if CAUSES[cause].is_law):
        best = _best_form(search, replace(known, fit=best.fit), cause, best, benches)
    fit, form_error = stated(benches[best.weighting], best.fit)
    return replace(best, fit=fit, form_error=form_error)


def _best_form(
    search: MaterialSearch,
    known: Hypothesis,
    cause: str,
    best: Refined,
    benches: dict[str, ProofInput],
) -> Refined:
    place, least = known.ids.index(cause), search.bench.problem.settings.material.worth
    for fit in _in_each_form(search, known, cause):
        if fit.parts[place].free_parameters.label == best.fit.parts[place].free_parameters.label:
            continue
        for name, bench in benches.items():
            tried = _of(bench, fit, name)
            simpler = len(fit.x) < len(best.fit.x)
            worth = 1.0 / (1.0 - least) if simpler else 1.0 - least
            if _error(search, tried) < worth * _error(search, best):
                best = tried
    return best


def _in_each_form(search: MaterialSearch, known: Hypothesis, cause: str) -> list[MaterialFit]:
    rest = search.lacking(known, cause)
    fits = search.in_forms(rest, cause)
    order = [*rest.ids, cause]
    return [_reordered(fit, order, known.ids) for fit in fits]


def _reordered(fit: MaterialFit, order: list[str], wanted: tuple[str, ...]) -> MaterialFit:
    """Return a fit whose causes and parameters, now in the order of the ids `order`, are in that of `wanted`."""
    places = [order.index(id) for id in wanted]
    index = np.concatenate([[0], *(np.arange(len(fit.x))[fit.slices()[place]] for place in places)]).astype(np.int64)
    parts = tuple(fit.parts[place] for place in places)
    return replace(fit, parts=parts, x=fit.x[index], covariance=fit.covariance[np.ix_(index, index)])


def _of(bench: ProofInput, fit: MaterialFit, weighting: str) -> Refined:
    if weighting == "rows alike":
        fit = fitted(bench.problem, fit.parts, [fit.x])
    return Refined(fit, held_out_errors(bench, fit), weighting)


def _error(search: MaterialSearch, refined: Refined) -> float:
    """Return the error (rms, kPa) that decides between fits: on held-out data, or of the fit for a single curve."""
    if search.bench.unit != "part":
        return refined.held_out.rms_all
    data = search.bench.problem.data
    return rms(data.stress - data.modelled(refined.fit.model))


def rows_alike(bench: ProofInput) -> ProofInput:
    """Return a bench (data, covariances and folds) on which the rows of a curve have equal weights in fits.

    Prediction errors are still measured in units of the full noise covariance.
    """
    data = bench.problem.data
    peaks = np.array([float(np.nanmax(np.abs(curve.stress))) for curve in data.curves])
    size = np.maximum(bench.errors.std, bench.problem.settings.material.rows_alike * peaks)[data.curve_of]
    own = np.diag(size**2)
    problem = replace(bench.problem, weights=weights_of(own, np.zeros_like(own)))
    return replace(bench, problem=problem, fitting=own)


def stated(bench: ProofInput, fit: MaterialFit) -> tuple[MaterialFit, float]:
    """Return a fit with the covariance due to noise, the model error of its form, and the prior; and that error.

    `bench`: its `noise` is the covariance of the curves' errors, its `fitting` the one that weights fits; `fit`: fit to
    all rows, which is otherwise unchanged. The error is the root mean square of that of the form (the formula of the
    law), over the stress. A form that agrees with the curves within their noise shows none here; only other modes,
    rates or strains can show whether it has one elsewhere.
    """
    data = bench.problem.data
    _, scale = prior_of(bench.problem, fit.parts)
    slopes = _slopes(bench, fit, scale)
    weighed = np.linalg.solve(bench.fitting + fit.share**2 * bench.generic, slopes)
    inverse = np.asarray(np.linalg.inv(slopes.T @ weighed + np.eye(len(scale))), np.float64)
    gain = inverse @ weighed.T
    residual = data.stress - data.modelled(fit.model)
    squared = _squared_size(bench, slopes, gain, inverse, residual)
    errors = gain @ (bench.noise + squared * bench.generic) @ gain.T + inverse @ inverse
    return replace(fit, covariance=scale[:, None] * errors * scale[None, :]), math.sqrt(squared)


def _squared_size(
    bench: ProofInput, slopes: FloatArray, gain: FloatArray, inverse: FloatArray, residual: FloatArray
) -> float:
    """Return the posterior mean square of the form's model error, over the stress.

    `slopes` (n, k): derivatives of stresses, kPa per prior deviation; `gain` (k, n): change of parameters by errors,
    1/kPa; `inverse` (k, k): covariance by the curvature, over prior deviations; `residual` (n,): measured minus
    modelled stress, kPa.
    """
    unit = np.sqrt(np.diag(bench.noise))
    # Simulated curves may be fitted to the last digit.
    found = max(float(np.sum((residual / unit) ** 2)), float(np.finfo(np.float64).tiny))
    maker = (np.eye(len(unit)) - slopes @ gain) / unit[:, None]
    prior = (slopes @ inverse) / unit[:, None]
    least = maker @ bench.noise @ maker.T + prior @ prior.T
    more = maker @ bench.generic @ maker.T
    numbers = bench.problem.settings.material
    shares, none = numbers.misfit_shares, numbers.no_misfit
    sizes = np.array([0.0, *shares])
    chances = np.array([none, *[(1.0 - none) / len(shares)] * len(shares)])
    logs = np.log(chances) + [_log_density(found, least + size**2 * more) for size in sizes]
    weights = np.exp(logs - logs.max())
    return float(weights @ sizes**2 / weights.sum())


def _log_density(found: float, covariance: FloatArray) -> float:
    """Return the log density of a sum of squared Gaussian numbers of a covariance (n, n), taken for a Gamma density."""
    mean, variance = float(np.trace(covariance)), 2.0 * float(np.sum(covariance**2))
    shape, unit = mean**2 / variance, variance / mean
    return (shape - 1.0) * math.log(found) - found / unit - math.lgamma(shape) - shape * math.log(unit)


def _slopes(bench: ProofInput, fit: MaterialFit, scale: FloatArray) -> FloatArray:
    """Return the derivatives (n, k) of the stresses, kPa, by parameters in prior deviations, which are `scale` (k,)."""
    problem, step = bench.problem, bench.problem.settings.material.step
    columns = []
    for i, unit in enumerate(scale):
        ends = []
        for sign in (1.0, -1.0):
            moved = fit.x.copy()
            moved[i] += sign * step * unit
            ends.append(problem.data.modelled(problem.model(fit.parts, moved)))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(columns, axis=1)
