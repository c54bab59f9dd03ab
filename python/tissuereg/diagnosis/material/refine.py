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
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.material.bench import CurveBench
from tissuereg.diagnosis.material.fit import (
    HeldOutErrors,
    Hypothesis,
    MaterialFit,
    chances_of_sizes,
    fitted,
    held_out_errors,
)
from tissuereg.diagnosis.material.noise import weights_of
from tissuereg.diagnosis.material.search import MaterialSearch


@dataclass(frozen=True, eq=False)
class Refined:
    """The reported fit of the causes found.

    `fit`: fit to all rows; its covariance includes the model error of its form (the formula of the law); `held_out`:
    errors on held-out data with the same form and weights; `weighting`: ``lasting errors`` (rows weighted by the full
    covariance with correlated errors) or ``rows alike`` (equally within a curve); `decides`: error (rms, kPa) by which
    it was chosen; `form_error`: root mean square of the form's model error, over the stress; NaN until it is estimated.
    """

    fit: MaterialFit
    held_out: HeldOutErrors
    weighting: str
    decides: float
    form_error: float = math.nan


def refined(search: MaterialSearch, known: Hypothesis) -> Refined:
    """Return the fit of the causes found, in the forms and with the weights that predict held-out data best."""
    benches = {"lasting errors": search.bench, "rows alike": rows_alike(search.bench)}
    if search.bench.unit == "part":
        # In a single curve only the noise model separates correlated errors from memory; other laws need none.
        del benches["rows alike" if known.fit.model.memory else "lasting errors"]
    best, least = min(_weighted(benches, known.fit), key=lambda one: one.decides), search.bench.settings.material.worth
    for place in [place for place, cause in enumerate(known.ids) if CAUSES[cause].is_law]:
        for fit in _in_each_form(search, replace(known, fit=best.fit), known.ids[place]):
            if fit.parts[place].free_parameters.label == best.fit.parts[place].free_parameters.label:
                continue
            for tried in _weighted(benches, fit):
                worth = 1.0 / (1.0 - least) if len(fit.x) < len(best.fit.x) else 1.0 - least
                if tried.decides < worth * best.decides:
                    best = tried
    fit, form_error = stated(benches[best.weighting], best.fit)
    return replace(best, fit=fit, form_error=form_error)


def _in_each_form(search: MaterialSearch, known: Hypothesis, cause: str) -> list[MaterialFit]:
    """Return fits of the causes found with one of them in each of its forms, likeliest first."""
    rest, fits = search.lacking(known, cause), []
    places = [[*rest.ids, cause].index(id) for id in known.ids]
    for fit in search.joined(rest, cause).forms:
        index = np.r_[(0, *(fit.slices()[i] for i in places))]
        parts, covariance = tuple(fit.parts[i] for i in places), fit.covariance[np.ix_(index, index)]
        fits.append(replace(fit, parts=parts, x=fit.x[index], covariance=covariance))
    return fits


def _weighted(benches: Mapping[str, CurveBench], fit: MaterialFit) -> list[Refined]:
    """Return a fit with each way to weight rows."""
    found = []
    for name, bench in benches.items():
        own = fitted(bench, fit.parts, [fit.x]) if name == "rows alike" else fit
        errors = held_out_errors(bench, own)
        # The error that decides between fits: on held-out data, or of the fit for a single curve.
        decides = rms(bench.data.residual(own.model)) if bench.unit == "part" else errors.rms_all
        found.append(Refined(own, errors, name, decides))
    return found


def rows_alike(bench: CurveBench) -> CurveBench:
    """Return a bench on which the rows of a curve have equal weights in fits; errors are measured as before."""
    peaks = np.array([float(np.nanmax(np.abs(curve.stress))) for curve in bench.data.curves])
    size = np.maximum(bench.errors.std, bench.settings.material.rows_alike * peaks)[bench.data.curve_of]
    own = np.diag(size**2)
    return replace(bench, weights=weights_of(own, np.zeros_like(own)), fitting=own)


def stated(bench: CurveBench, fit: MaterialFit) -> tuple[MaterialFit, float]:
    """Return a fit with the covariance due to noise, the model error of its form, and the prior; and that error.

    The error is the root mean square of that of the form (the formula of the law), over the stress. A form that agrees
    with the curves within their noise shows none here; only other modes, rates or strains can show whether it has one
    elsewhere.
    """
    _, scale = bench.prior(fit.parts)
    slopes = _slopes(bench, fit, scale)
    weighed = np.linalg.solve(bench.fitting + fit.share**2 * bench.generic, slopes)
    inverse = np.asarray(np.linalg.inv(slopes.T @ weighed + np.eye(len(scale))), np.float64)
    gain = inverse @ weighed.T
    squared = _squared_size(bench, fit, slopes, gain, inverse)
    errors = gain @ (bench.noise + squared * bench.generic) @ gain.T + inverse @ inverse
    return replace(fit, covariance=scale[:, None] * errors * scale[None, :]), math.sqrt(squared)


def _squared_size(
    bench: CurveBench, fit: MaterialFit, slopes: FloatArray, gain: FloatArray, inverse: FloatArray
) -> float:
    """Return the posterior mean square of the form's model error, over the stress; arguments as in `stated`."""
    unit = np.sqrt(np.diag(bench.noise))
    # Simulated curves may be fitted to the last digit.
    found = max(float(np.sum((bench.data.residual(fit.model) / unit) ** 2)), float(np.finfo(np.float64).tiny))
    maker = (np.eye(len(unit)) - slopes @ gain) / unit[:, None]
    prior = (slopes @ inverse) / unit[:, None]
    least = maker @ bench.noise @ maker.T + prior @ prior.T
    more = maker @ bench.generic @ maker.T
    chances = chances_of_sizes(bench.settings.material)
    sizes = np.array([*chances])
    logs = np.log([*chances.values()]) + [_log_density(found, least + size**2 * more) for size in sizes]
    weights = np.exp(logs - logs.max())
    return float(weights @ sizes**2 / weights.sum())


def _log_density(found: float, covariance: FloatArray) -> float:
    """Return the log density of a sum of squared Gaussian numbers of a covariance (n, n), taken for a Gamma density."""
    mean, variance = float(np.trace(covariance)), 2.0 * float(np.sum(covariance**2))
    shape, unit = mean**2 / variance, variance / mean
    return (shape - 1.0) * math.log(found) - found / unit - math.lgamma(shape) - shape * math.log(unit)


def _slopes(bench: CurveBench, fit: MaterialFit, scale: FloatArray) -> FloatArray:
    """Return the derivatives (n, k) of the stresses, kPa, by parameters in prior deviations, which are `scale` (k,)."""
    step, columns = bench.settings.material.step, []
    for moved in np.diag(step * scale):
        ends = [bench.data.modelled(bench.model(fit.parts, x)) for x in (fit.x + moved, fit.x - moved)]
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(columns, axis=1)
