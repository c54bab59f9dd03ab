"""Standard deviations of fitted parameters, from the noise and from the model error of the form.

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
from tissuereg.diagnosis.material.fit import MaterialFit, prior_of
from tissuereg.diagnosis.material.holdout import ProofInput


@dataclass(frozen=True, eq=False)
class StatedFit:
    """A fit with the covariance that is reported.

    `fit`: fit whose covariance includes noise, the form's model error and the prior; `form_error`: root mean square of
    the model error of its form (the formula of the law), over the stress.
    """

    fit: MaterialFit
    form_error: float


def stated(bench: ProofInput, fit: MaterialFit) -> StatedFit:
    """Return a fit with the covariance due to noise, the model error of its form, and the prior.

    `bench`: its `noise` is the covariance of the curves' errors, its `fitting` the one that weights fits; `fit`: fit to
    all rows. Result: the fit is otherwise unchanged; a form is the formula of a law or effect with fitted parameters.

    Notes
    -----
    Costs a few products of (n_rows, n_rows) matrices, milliseconds. A form that agrees with the curves within their
    noise shows no model error here; only other modes, rates or strains can show whether it has one elsewhere.
    """
    data = bench.problem.data
    _, scale = prior_of(bench.problem, fit.forms)
    slopes = _slopes(bench, fit, scale)
    own = bench.noise if bench.fitting is None else bench.fitting
    weighed = np.linalg.solve(own + fit.share**2 * bench.generic, slopes)
    inverse = np.asarray(np.linalg.inv(slopes.T @ weighed + np.eye(len(scale))), np.float64)
    gain = inverse @ weighed.T
    residual = data.stress - data.modelled(fit.model)
    squared = _squared_size(bench, slopes, gain, inverse, residual)
    errors = gain @ (bench.noise + squared * bench.generic) @ gain.T + inverse @ inverse
    return StatedFit(replace(fit, covariance=scale[:, None] * errors * scale[None, :]), math.sqrt(squared))


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
    """Return the log density, at `found`, of a sum of squared Gaussian numbers of mean 0 and given covariance (n, n).

    The density is approximated by that of a Gamma distribution of the same mean and variance.
    """
    mean, variance = float(np.trace(covariance)), 2.0 * float(np.sum(covariance**2))
    shape, unit = mean**2 / variance, variance / mean
    return (shape - 1.0) * math.log(found) - found / unit - math.lgamma(shape) - shape * math.log(unit)


def _slopes(bench: ProofInput, fit: MaterialFit, scale: FloatArray) -> FloatArray:
    """Return the derivatives of the n stresses by the k parameters, shape (n, k), in kPa per prior standard deviation.

    `scale` (k,): prior standard deviations.
    """
    problem, step = bench.problem, bench.problem.settings.material.step
    columns = []
    for i, unit in enumerate(scale):
        ends = []
        for sign in (1.0, -1.0):
            moved = fit.x.copy()
            moved[i] += sign * step * unit
            ends.append(problem.data.modelled(problem.model(fit.forms, moved)))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(columns, axis=1)
