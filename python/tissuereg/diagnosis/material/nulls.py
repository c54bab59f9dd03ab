"""Threshold and p-value from simulated null experiments, which have noise but no effect."""

from collections.abc import Mapping, Sequence

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import FreeParameters
from tissuereg.diagnosis.evidence import log_bayes_factors
from tissuereg.diagnosis.fit import FittedCause
from tissuereg.diagnosis.material.fit import FitProblem, MaterialFit, prior_of
from tissuereg.diagnosis.material.noise import Weights
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.errors import TissueRegError


def threshold(
    problem: FitProblem,
    known: MaterialFit,
    forms: Mapping[str, Sequence[FreeParameters]],
    rng: np.random.Generator,
) -> float:
    """Return the log Bayes factor that the best cause exceeds in one of a hundred null experiments.

    Every form (formula of a cause) is linearised about its first guesses: one column of stress with a unit prior
    amplitude, in addition to the column of the modulus. `problem`: data, weights and believed model; `known`: fit of
    the believed model; `forms`: by id of the cause; `rng`: random generator of the noise. Result: nats, at least
    `least_threshold`.
    """
    numbers = problem.settings.material
    n_nulls = numbers.thresholds_from
    draws = rng.standard_normal((len(problem.data.stress), n_nulls))
    young = _young_column(problem, known)
    best = np.full(n_nulls, -np.inf)
    for cause, kinds in forms.items():
        for form in kinds:
            columns = _columns(problem, known, FittedCause(cause, form))
            if columns.size:
                scores = np.array([log_bayes_factors(draws, np.column_stack([young, c])) for c in columns.T])
                best = np.maximum(best, np.logaddexp.reduce(scores, axis=0) - np.log(len(scores)))
    best = best - log_bayes_factors(draws, young[:, None])
    return max(numbers.least_threshold, float(np.quantile(best, numbers.quantile)))


def misfit_probability(
    weights: Weights, residual: FloatArray, rng: np.random.Generator, settings: MaterialSettings
) -> float:
    """Return the p-value of the structure in a residual.

    The statistic is the largest log likelihood ratio of a generic misfit (a smooth Gaussian process) against none, over
    its sizes. `weights`: whitening of the rows; `residual` (n,): measured minus modelled, kPa; `rng`: random generator
    of the noise; `settings`: number of residuals of noise alone, and how uncertain their size is. Result: above 0.
    """
    n_nulls, shares = settings.misfits_from, settings.misfit_shares
    found = _structure(weights, weights.whitened(residual)[:, None], shares)[0]
    scale = np.exp(settings.noise_spread * rng.standard_normal(n_nulls))
    nulls = _structure(weights, rng.standard_normal((len(residual), n_nulls)) * scale, shares)
    return float((1 + (nulls >= found).sum()) / (1 + n_nulls))


def _structure(weights: Weights, white: FloatArray, shares: Sequence[float]) -> FloatArray:
    gains = []
    for share in shares:
        grown = share**2 * weights.spectrum
        gains.append(0.5 * (white**2).T @ (grown / (1.0 + grown)) - 0.5 * np.log1p(grown).sum())
    return np.asarray(np.max(gains, axis=0))


def _young_column(problem: FitProblem, known: MaterialFit) -> FloatArray:
    _, std = prior_of(problem, ())
    moved = problem.model((), known.x + np.array([1e-3]))
    change = (problem.data.modelled(moved) - problem.data.modelled(known.model)) / 1e-3
    column: FloatArray = problem.weights.whitened(change * float(std[0]))
    return column


def _columns(problem: FitProblem, known: MaterialFit, part: FittedCause) -> FloatArray:
    plain = problem.data.modelled(known.model)
    columns = []
    for start in (*part.free_parameters.guesses, part.free_parameters.mean):
        if not len(start):
            continue
        try:
            changed = problem.data.modelled(problem.model((part,), np.concatenate([known.x, start])))
        except TissueRegError:
            continue
        if np.isfinite(changed).all():
            columns.append(problem.weights.whitened(changed - plain))
    return np.stack(columns, axis=1) if columns else np.zeros((len(plain), 0))
