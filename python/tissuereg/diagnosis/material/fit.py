"""Fit of one hypothesis: nonlinear least squares (Levenberg-Marquardt), and evidence by Laplace's approximation.

With whitened residual r(x) and z = (x - mean) / std in units of the Gaussian prior, |r|^2 + |z|^2 is minimised; the log
evidence is -1/2 (|r|^2 + |z|^2) - 1/2 log det(1 + share^2 Lambda) - 1/2 log det(J^T J), with J the Jacobian of (r, z)
by z and Lambda the spectrum of the generic misfit (`noise`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.fit import FittedCause, FittedModel, effects_of
from tissuereg.diagnosis.material.data import Data
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.material.noise import Weights
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.errors import TissueRegError
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import OtherLaw, Stiffness
from tissuereg.experiment.material_experiment import MaterialExperiment

Residuals = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Data, weights and believed model that all fits to a material test share.

    `base`: the believed model; `data`: rows (measured points) that are fitted; `weights`: whitening of their residuals;
    `young_log`, `young_std`: prior mean and standard deviation of the logarithm of Young's modulus in kPa; `settings`:
    all numbers of the diagnosis.
    """

    base: Model
    data: Data
    weights: Weights
    young_log: float
    young_std: float
    settings: DiagnoseSettings = DEFAULT

    def model(self, parts: Sequence[FittedCause], x: FloatArray) -> Model:
        """Return the believed model with causes, each in one form, at the parameters `x`.

        `x` (n,): the logarithm of Young's modulus in kPa, then the parameters of every cause.
        """
        young = float(np.exp(np.clip(x[0], -30.0, 30.0)))
        effects = effects_of(parts, x, young)
        return self.base.with_young(young).with_effects(one for one in effects if not isinstance(one, Stiffness))


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


def prior_of(problem: FitProblem, parts: Sequence[FittedCause]) -> tuple[FloatArray, FloatArray]:
    """Return prior mean and standard deviation, each (n,), of the log modulus (kPa) and each cause's parameters."""
    wide = any(part.id == "stiffness" for part in parts)
    of_young = problem.settings.material.wide_young if wide else problem.young_std
    mean = np.concatenate([[problem.young_log], *(part.free_parameters.mean for part in parts)])
    return mean, np.concatenate([[of_young], *(part.free_parameters.deviation for part in parts)])


def fitted(
    problem: FitProblem, parts: Sequence[FittedCause], starts: Sequence[FloatArray], share: float = 0.0
) -> MaterialFit:
    """Return the fit of a hypothesis, the best from several starts.

    `problem`: data, weights and believed model; `parts`: its causes; `starts`: first guesses, each (n,);
    `share`: size of the generic misfit in its covariance, over the stress; 0 for none. Result: the fit with the largest
    log posterior.
    """
    ends = [_descent(problem, parts, start, share) for start in starts]
    return max(ends, key=lambda fit: fit.log_posterior)


def _descent(problem: FitProblem, parts: Sequence[FittedCause], start: FloatArray, share: float) -> MaterialFit:
    mean, std = prior_of(problem, parts)
    measured = problem.data.stress

    def residuals(z: FloatArray) -> FloatArray:
        try:
            modelled = problem.data.modelled(problem.model(parts, mean + std * z))
        except TissueRegError:
            modelled = np.full(len(measured), np.nan)
        if not np.isfinite(modelled).all():
            return np.concatenate([np.full(len(measured), problem.settings.material.no_stress), z])
        white = problem.weights.whitened(measured - modelled, share)
        return np.concatenate([np.clip(white, -1e8, 1e8), z])

    z, value, jacobian = _levenberg(residuals, (start - mean) / std, problem.settings.material.step)
    curvature = jacobian.T @ jacobian
    log_posterior = -0.5 * float(value @ value) - problem.weights.log_size(share)
    # With the prior every eigenvalue is at least 1, but for rounding errors where the stress becomes huge.
    occam = 0.5 * max(0.0, float(np.linalg.slogdet(curvature)[1]))
    # Keeps it regular against the same rounding errors.
    rounding = 1e-13 * float(np.trace(curvature)) * np.eye(len(z))
    covariance = std[:, None] * np.linalg.inv(curvature + rounding) * std[None, :]
    x = mean + std * z
    model = problem.model(parts, x)
    return MaterialFit(tuple(parts), x, covariance, share, log_posterior - occam, log_posterior, model)


def _levenberg(residuals: Residuals, z: FloatArray, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the point (k,) that minimises half the sum of squared residuals, with residuals (m,) and Jacobian (m, k).

    `residuals`: function of a point (k,), which includes the prior; `z` (k,): start. The method is damped Gauss-Newton;
    the Jacobian is taken by finite differences, which cost less than analytic derivatives of the stress.
    """
    z = np.clip(z, -6.0, 6.0)
    value = residuals(z)
    jacobian = _differences(residuals, z, value, h)
    damping = 1e-2
    for _ in range(40):
        gradient = jacobian.T @ value
        curvature = jacobian.T @ jacobian
        cost = float(value @ value)
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
        gain = cost - float(new @ new)
        z, value = tried, new
        damping = max(damping / 8.0, 1e-9)
        jacobian = _differences(residuals, z, value, h)
        if gain < 1e-3:
            break
    return z, value, jacobian


def _differences(residuals: Residuals, z: FloatArray, value: FloatArray, h: float) -> FloatArray:
    columns = []
    for i in range(len(z)):
        moved = z.copy()
        moved[i] += h
        columns.append((residuals(moved) - value) / h)
    return np.stack(columns, axis=1)


def extended(experiment: MaterialExperiment, fit: MaterialFit) -> MaterialExperiment:
    """Return an experiment with the causes found as its effects; `fit`: fit of the causes found.

    Each new effect replaces an older one of the same id, or an older law; Young's modulus is the fitted one, unless it
    is itself a finding.
    """

    def replaced(old: Effect) -> bool:
        return any(old.id == new.id or (isinstance(old, OtherLaw) and isinstance(new, OtherLaw)) for new in fit.effects)

    kept = [old for old in experiment.effects if not replaced(old)]
    changed = replace(experiment, effects=(*kept, *fit.effects))
    if any(effect.id == "stiffness" for effect in changed.effects):
        return changed
    young = float(np.exp(fit.x[0]))
    std = young * float(np.sqrt(fit.covariance[0, 0]))
    return replace(changed, material=replace(experiment.material, young=young), young_std=std)
