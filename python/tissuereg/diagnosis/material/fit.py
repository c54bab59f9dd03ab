"""Fits to a material test: hypotheses, their evidence, and their errors on held-out rows.

A fit is nonlinear least squares (Levenberg-Marquardt). With whitened residual r(x) and z = (x - mean) / std in units of
the Gaussian prior, |r|^2 + |z|^2 is minimised; the log evidence, by Laplace's approximation, is
-1/2 (|r|^2 + |z|^2) - 1/2 log det(1 + share^2 Lambda) - 1/2 log det(J^T J), with J the Jacobian of (r, z) by z and
Lambda the spectrum of a generic misfit of size `share` (`noise`). That of a hypothesis is the mean over the forms tried
and over the sizes of a generic misfit, with prior weights. A stress costs so little that the Jacobian is taken by
finite differences at every step, and that what is held out is predicted by a fit to all other rows.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES, FreeParameters
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.fit import FittedCause, FittedModel, effects_of
from tissuereg.diagnosis.material.bench import CurveBench
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.material.noise import weights_of
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.errors import TissueRegError
from tissuereg.experiment.effects import Effect

Residuals = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class MaterialFit(FittedModel):
    """The believed law with some causes, each in one form (formula of a law or effect), fitted to curves.

    The first of its parameters is the logarithm of Young's modulus in kPa; its covariance is valid if form and noise
    model are correct (`refine.stated` gives the one that is reported). `share`: size of the generic misfit (a smooth
    Gaussian process) in its covariance, over the stress; 0 for none; `evidence`: log evidence, up to a constant that
    all hypotheses have in common; `log_posterior`: log posterior density at `x`: the log evidence without Occam's
    factor; `model`: the model at `x`.
    """

    share: float
    evidence: float
    log_posterior: float
    model: Model

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects (changes of the believed model) at the fitted parameters, one for each cause, in their order."""
        return effects_of(self.parts, self.x, float(np.exp(self.x[0])))


def fitted(
    bench: CurveBench, parts: Sequence[FittedCause], starts: Sequence[FloatArray], share: float = 0.0
) -> MaterialFit:
    """Return the likeliest fit of causes from several starts (n,), with a generic misfit of size `share`."""
    return max((_descent(bench, parts, start, share) for start in starts), key=lambda fit: fit.log_posterior)


def _descent(bench: CurveBench, parts: Sequence[FittedCause], start: FloatArray, share: float) -> MaterialFit:
    mean, std = bench.prior(parts)
    failed = np.full(len(bench.data.stress), bench.settings.material.no_stress)

    def residuals(z: FloatArray) -> FloatArray:
        white = failed
        with suppress(TissueRegError):
            residual = bench.data.residual(bench.model(parts, mean + std * z))
            if np.isfinite(residual).all():
                white = np.clip(bench.weights.whitened(residual, share), -1e8, 1e8)
        return np.concatenate([white, z])

    z, value, jacobian = _levenberg(residuals, (start - mean) / std, bench.settings.material.step)
    x, curvature = mean + std * z, jacobian.T @ jacobian
    top = -0.5 * float(value @ value) - bench.weights.log_size(share)
    # With the prior every eigenvalue is at least 1, but for rounding errors where the stress becomes huge.
    occam = 0.5 * max(0.0, float(np.linalg.slogdet(curvature)[1]))
    # Keeps it regular against the same rounding errors.
    rounding = 1e-13 * float(np.trace(curvature)) * np.eye(len(z))
    covariance = std[:, None] * np.linalg.inv(curvature + rounding) * std[None, :]
    return MaterialFit(tuple(parts), x, covariance, share, top - occam, top, bench.model(parts, x))


def _levenberg(residuals: Residuals, z: FloatArray, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the point (k,) of the least squares from a start (k,), its residuals (m,) and their Jacobian (m, k)."""

    def differences() -> FloatArray:
        return np.stack([(residuals(z + row) - value) / h for row in h * np.eye(len(z))], axis=1)

    z = np.clip(z, -6.0, 6.0)
    value = residuals(z)
    jacobian, damping = differences(), 1e-2
    for _ in range(40):
        gradient, curvature, cost = jacobian.T @ value, jacobian.T @ jacobian, float(value @ value)
        while damping < 1e8:
            damped = curvature + damping * np.diag(np.diag(curvature)) + 1e-13 * np.trace(curvature) * np.eye(len(z))
            step = -np.linalg.solve(damped, gradient)
            tried = z + np.clip(step, -2.0, 2.0)
            new = residuals(tried)
            if float(new @ new) < cost:
                break
            damping *= 4.0
        else:
            break
        z, value, damping = tried, new, max(damping / 8.0, 1e-9)
        jacobian = differences()
        if cost - float(value @ value) < 1e-3:
            break
    return z, value, jacobian


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


def null_hypothesis(bench: CurveBench) -> Hypothesis:
    """Return the fitted null hypothesis: the believed law holds, with Young's modulus within its prior."""
    fit = fitted(bench, (), [np.array([bench.young_log])])
    return Hypothesis((), fit, fit.evidence)


def plain_fit(bench: CurveBench) -> MaterialFit:
    """Return the fit of the believed law to independent rows, the usual practice, whose evidence means nothing here."""
    weights = weights_of(np.diag(np.diag(bench.noise)), np.zeros_like(bench.noise))
    return null_hypothesis(replace(bench, weights=weights)).fit


def unknown(bench: CurveBench, known: Hypothesis) -> Hypothesis:
    """Return the generic rival ``unknown``: the causes found so far, and a smooth misfit, of its likeliest size."""
    fits = [fitted(bench, known.fit.parts, [known.fit.x], size) for size in bench.settings.material.misfit_shares]
    best = max(fits, key=lambda fit: fit.evidence)
    return Hypothesis((*known.ids, "unknown"), best, _mean([fit.evidence for fit in fits]))


def with_cause(bench: CurveBench, known: Hypothesis, cause: str, forms: Sequence[FreeParameters]) -> Hypothesis:
    """Return the hypothesis with one more cause, in the best of its forms; those of the others are kept."""
    found: list[tuple[MaterialFit, float]] = []
    for form in forms:
        # The fit of a simpler form gives a first guess for a richer one.
        starts = [np.concatenate([known.fit.x, start]) for start in (*form.guesses, *_grown(form, found))]
        found.append(refitted(bench, (*known.fit.parts, FittedCause(cause, form)), starts))
    evidence = _mean([evidence for _, evidence in found])
    found.sort(key=lambda pair: -pair[1])
    # Of forms with about the same evidence, that with the fewest parameters.
    as_good = [fit for fit, own in found if own >= found[0][1] - bench.settings.material.simpler]
    best = min(as_good, key=lambda fit: len(fit.x))
    return Hypothesis((*known.ids, cause), best, evidence, tuple(fit for fit, _ in found))


def refitted(
    bench: CurveBench, parts: Sequence[FittedCause], starts: Sequence[FloatArray]
) -> tuple[MaterialFit, float]:
    """Return the fit of causes in given forms, with or without a generic misfit, and the log evidence of both."""
    priors = chances_of_sizes(bench.settings.material)
    plain = fitted(bench, parts, starts)
    residual = bench.data.residual(plain.model)

    def score(share: float) -> float:
        white = bench.weights.whitened(residual, share)
        return -0.5 * float(white @ white) - bench.weights.log_size(share) + math.log(priors[share])

    share, without = max(priors, key=score), plain.evidence + math.log(priors[0.0])
    if share == 0.0:
        return plain, without
    smooth = fitted(bench, parts, [plain.x], share)
    beside = smooth.evidence + math.log(priors[share])
    return (smooth if beside > without else plain), float(np.logaddexp(without, beside))


def chances_of_sizes(settings: MaterialSettings) -> dict[float, float]:
    """Return the prior probability of each size of a generic misfit beside the causes, over the stress; 0 for none."""
    shares = settings.misfit_shares
    return {0.0: settings.no_misfit, **dict.fromkeys(shares, (1.0 - settings.no_misfit) / len(shares))}


def excluded(cause: str, known: Sequence[str]) -> bool:
    """Return whether a cause cannot stand beside those found, given by their ids: it is one, or another law."""
    return cause in known or (CAUSES[cause].is_law and any(CAUSES[other].is_law for other in known))


def _mean(logs: Sequence[float]) -> float:
    return float(np.logaddexp.reduce(logs)) - math.log(len(logs))


def _grown(form: FreeParameters, found: Sequence[tuple[MaterialFit, float]]) -> list[FloatArray]:
    """Return first guesses for a Prony series from the fit of the one with a term less, the last that was found."""
    if not found or not form.label.startswith("prony"):
        return []
    n = len(form.mean) // 2
    # Parameters of the shares, then the logarithms of the times in s.
    shares, times = found[-1][0].x[-2 * (n - 1) :].reshape(2, -1)
    return [np.concatenate([shares, [-1.5], times, [new]]) for new in (times.min() - 1.5, times.max() + 1.5)]


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of a hypothesis' predictions of held-out rows, by block (rows held out together) and in all.

    `rms`: root mean square error by name of the block, kPa; `chi`: root mean square of the error over its standard
    deviation, all blocks together; NaN without predictions; `misfits`: half the sum of squared whitened errors, by name
    of the block; `rms_all`: root mean square error of all blocks together, kPa; NaN without predictions.
    """

    rms: dict[str, float]
    chi: float
    misfits: dict[str, float]
    rms_all: float

    @property
    def total(self) -> float:
        """Sum of `misfits` over all blocks."""
        return sum(self.misfits.values())


def held_out_errors(bench: CurveBench, fit: MaterialFit, *, patch_share: float | None = None) -> HeldOutErrors:
    """Return the errors of a hypothesis on every block, each predicted by a fit to all other rows.

    `fit`: fit to all rows; its parameters are the first guess; `patch_share`: size, over the stress, of a generic
    misfit (Gaussian process) that is conditioned on the fitted rows and added to the prediction; none where absent.
    """
    errors, chi, misfits = {}, {}, {}
    share = fit.share if patch_share is None else patch_share
    for name, mask in bench.blocks.items():
        if not mask.any() or (~mask).sum() <= len(fit.x):
            continue
        known, data, aside = np.ix_(~mask, ~mask), bench.data.part(~mask), bench.data.part(mask)
        fitting, generic, own = bench.fitting[known], bench.generic[known], bench.noise[np.ix_(mask, mask)]
        if not fit.parts and patch_share is None:
            # The believed law is fitted as a user would do: correlated errors would fit a wrong law to slopes alone.
            fitting = np.diag(np.diag(fitting))
        again = fitted(replace(bench, data=data, weights=weights_of(fitting, generic)), fit.parts, [fit.x], share)
        error = aside.residual(again.model)
        if patch_share is not None:
            across = share**2 * bench.generic[np.ix_(mask, ~mask)]
            error -= across @ np.linalg.solve(bench.noise[known] + share**2 * generic, data.residual(again.model))
        # Where the law has no stress, the prediction is zero.
        errors[name] = error = np.where(np.isfinite(error), error, aside.stress)
        white = np.linalg.solve(np.linalg.cholesky(own), error)
        misfits[name] = 0.5 * float(white @ white)
        chi[name] = error / np.sqrt(np.diag(own))
    of_all = [rms(np.concatenate([*one.values()])) if one else math.nan for one in (chi, errors)]
    return HeldOutErrors({name: rms(error) for name, error in errors.items()}, of_all[0], misfits, of_all[1])
