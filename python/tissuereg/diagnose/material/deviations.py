"""What noise, and the error of the form itself, do to fitted numbers.

A fit weighs rows in some way; its numbers follow every error of the rows to first order: ``dx = G e``, with
``G = (J^T W J + 1)^-1 J^T W`` in units of the prior. What `e` is does not depend on those weights: the noise of the
curves, errors that last along a curve and factors of specimens included, and what the form cannot follow. The latter
is the smooth misfit that also competes as ``unknown``, of a size that is not known:

    cov(x) = sum_s p(s | q) G (noise + s^2 generic) G^T + (J^T W J + 1)^-2

The last part is the prior's. Sizes are weighed by the sum `q` of squared residuals, each over the variance of its
noise: its mean and variance under every size, the freedom of the numbers taken off, give a Gamma density. The
likelihood of the whole residual would find the size from its roughness, which is far below its size where a form bends
the wrong way. Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001, on numbers fitted beside a misfit.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.material.fit import Fit, prior_of
from tissuereg.diagnose.material.holdout import Bench
from tissuereg.diagnose.material.hypothesis import NO_MISFIT
from tissuereg.diagnose.material.weights import SHARES

#: Step of the numbers over their prior's standard deviation, for differences.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Stated:
    """A fit whose deviations can be stated.

    Attributes
    ----------
    fit : Fit
        Its covariance carries noise, the form's error and the prior.
    form_error : float
        Root mean square size of what the form cannot follow, over the stress.
    """

    fit: Fit
    form_error: float


def stated(bench: Bench, fit: Fit) -> Stated:
    """Return a fit with the covariance that noise and the error of its form give its numbers.

    Parameters
    ----------
    bench : Bench
        That the fit was made on: its `noise` is that of the curves, its `fitting` what fits are weighted by.
    fit : Fit
        Of all its rows.

    Returns
    -------
    Stated
        Other numbers of the fit stay.

    Notes
    -----
    A few products of matrices of one row and column a stress, milliseconds. A form that follows the curves within
    their noise shows no error here; that it may have one elsewhere only other modes, rates or strains can tell.
    """
    data = bench.problem.data
    _, scale = prior_of(bench.problem, fit.forms)
    slopes = _slopes(bench, fit, scale)
    own = bench.noise if bench.fitting is None else bench.fitting
    weighed = np.linalg.solve(own + fit.share**2 * bench.generic, slopes)
    inverse = np.linalg.inv(slopes.T @ weighed + np.eye(len(scale)))
    gain = inverse @ weighed.T
    residual = data.stress - data.modelled(fit.model)
    squared = _squared_size(bench, slopes, gain, inverse, residual)
    errors = gain @ (bench.noise + squared * bench.generic) @ gain.T + inverse @ inverse
    return Stated(replace(fit, covariance=scale[:, None] * errors * scale[None, :]), math.sqrt(squared))


def _squared_size(
    bench: Bench, slopes: FloatArray, gain: FloatArray, inverse: FloatArray, residual: FloatArray
) -> float:
    """Return the mean square of the form's error over the stress, all sizes weighed."""
    unit = np.sqrt(np.diag(bench.noise))
    # Made-up curves may be followed to the last digit.
    found = max(float(np.sum((residual / unit) ** 2)), float(np.finfo(np.float64).tiny))
    maker = (np.eye(len(unit)) - slopes @ gain) / unit[:, None]
    prior = (slopes @ inverse) / unit[:, None]
    least = maker @ bench.noise @ maker.T + prior @ prior.T
    more = maker @ bench.generic @ maker.T
    sizes = np.array([0.0, *SHARES])
    chances = np.array([NO_MISFIT, *[(1.0 - NO_MISFIT) / len(SHARES)] * len(SHARES)])
    logs = np.log(chances) + [_log_density(found, least + size**2 * more) for size in sizes]
    weights = np.exp(logs - logs.max())
    return float(weights @ sizes**2 / weights.sum())


def _log_density(found: float, covariance: FloatArray) -> float:
    """Return the log density of a sum of squares of Gaussian numbers, as of the Gamma of its mean and variance."""
    mean, variance = float(np.trace(covariance)), 2.0 * float(np.sum(covariance**2))
    shape, unit = mean**2 / variance, variance / mean
    return (shape - 1.0) * math.log(found) - found / unit - math.lgamma(shape) - shape * math.log(unit)


def _slopes(bench: Bench, fit: Fit, scale: FloatArray) -> FloatArray:
    """Return the derivatives of the stresses by the numbers, in units of their prior."""
    problem = bench.problem
    columns = []
    for i, unit in enumerate(scale):
        ends = []
        for sign in (1.0, -1.0):
            moved = fit.x.copy()
            moved[i] += sign * _STEP * unit
            ends.append(problem.data.modelled(problem.model(fit.forms, moved)))
        columns.append((ends[0] - ends[1]) / (2.0 * _STEP))
    return np.stack(columns, axis=1)
