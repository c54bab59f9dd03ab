"""Fit of one hypothesis: nonlinear least squares (Levenberg-Marquardt), and evidence by Laplace's approximation.

With whitened residual r(x) and z = (x - mean) / std in units of the Gaussian prior, |r|^2 + |z|^2 is minimised; the log
evidence is -1/2 (|r|^2 + |z|^2) - 1/2 log det(1 + share^2 Lambda) - 1/2 log det(J^T J), with J the Jacobian of (r, z)
by z and Lambda the spectrum of the generic misfit (`noise`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.evidence import slices_of
from tissuereg.diagnosis.material.causes import Form
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

    def model(self, forms: Sequence[Form], x: FloatArray) -> Model:
        """Return the believed model with causes in the given forms, at the parameters `x`.

        `x` (n,): the logarithm of Young's modulus in kPa, then the parameters of every form.
        """
        model = self.base.with_young(float(np.exp(np.clip(x[0], -30.0, 30.0))))
        return model.with_effects(one for one in effects_of(forms, x) if not isinstance(one, Stiffness))


@dataclass(frozen=True, eq=False)
class MaterialFit:
    """A fitted hypothesis: the believed law with some causes, each in one form (formula of a law or effect).

    `forms`: forms of its causes; `x` (n,): logarithm of Young's modulus in kPa, then the parameters of each form;
    `covariance` (n, n): of `x`, from the curvature; valid if form and noise model are correct (`refine.stated` gives
    the one that is reported); `share`: size of the generic misfit (a smooth Gaussian process) in its covariance, over
    the stress; 0 for none; `evidence`: log evidence, up to a constant that all hypotheses have in common;
    `log_posterior`: log posterior density at `x`: the log evidence without Occam's factor; `model`: the model at `x`.
    """

    forms: tuple[Form, ...]
    x: FloatArray
    covariance: FloatArray
    share: float
    evidence: float
    log_posterior: float
    model: Model

    @property
    def effects(self) -> list[Effect]:
        """Effects (changes of the believed model) at the fitted parameters, one for each form, in their order."""
        return effects_of(self.forms, self.x)

    @property
    def slices(self) -> list[slice]:
        """For every form the slice of `x` that holds its parameters."""
        return slices_of(len(form.mean) for form in self.forms)


def effects_of(forms: Sequence[Form], x: FloatArray) -> list[Effect]:
    """Return the effects (changes of the believed model) at the parameters `x`, one for each form.

    `x` (n,): the logarithm of Young's modulus in kPa, then the parameters of each form.
    """
    return [
        Stiffness(young_kpa=float(np.exp(x[0]))) if form.effect is None else form.effect(x[mine])
        for form, mine in zip(forms, slices_of(len(form.mean) for form in forms), strict=True)
    ]


def prior_of(problem: FitProblem, forms: Sequence[Form]) -> tuple[FloatArray, FloatArray]:
    """Return prior mean and standard deviation, each (n,), of the log modulus (kPa) and each form's parameters."""
    wide = any(form.effect is None for form in forms)
    mean = np.concatenate([[problem.young_log], *(form.mean for form in forms)])
    std = np.concatenate(
        [[problem.settings.material.wide_young if wide else problem.young_std], *(form.std for form in forms)]
    )
    return mean, std


def fitted(problem: FitProblem, forms: Sequence[Form], starts: Sequence[FloatArray], share: float = 0.0) -> MaterialFit:
    """Return the fit of a hypothesis, the best from several starts.

    `problem`: data, weights and believed model; `forms`: forms of its causes; `starts`: first guesses, each (n,);
    `share`: size of the generic misfit in its covariance, over the stress; 0 for none. Result: the fit with the largest
    log posterior.
    """
    ends = [_descent(problem, forms, start, share) for start in starts]
    return max(ends, key=lambda fit: fit.log_posterior)


def _descent(problem: FitProblem, forms: Sequence[Form], start: FloatArray, share: float) -> MaterialFit:
    mean, std = prior_of(problem, forms)
    measured = problem.data.stress

    def residuals(z: FloatArray) -> FloatArray:
        try:
            modelled = problem.data.modelled(problem.model(forms, mean + std * z))
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
    model = problem.model(forms, x)
    return MaterialFit(tuple(forms), x, covariance, share, log_posterior - occam, log_posterior, model)


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
