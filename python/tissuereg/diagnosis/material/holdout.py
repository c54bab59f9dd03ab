"""Held-out proof for material tests: prediction of a mode, rate, specimen or last part of the curves from the rest."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.material.data import Data
from tissuereg.diagnosis.material.fit import FitProblem, MaterialFit, fitted
from tissuereg.diagnosis.material.noise import CurveNoise, patched, weights_of
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.material_experiment import HELD_OUT, MaterialExperiment


@dataclass(frozen=True, eq=False)
class Fold:
    """A set of rows (measured points) that are held out of a fit together.

    `name`: what is held out, for instance ``compression``; `held_out` (n,): whether each row is held out.
    """

    name: str
    held_out: BoolArray


@dataclass(frozen=True, eq=False)
class ProofInput:
    """The n rows, covariances and folds that held-out proofs need.

    `unit`: what each fold holds out: a ``mode``, a ``rate``, a ``specimen``, or the last ``part`` of the curves;
    `folds`: sets of rows; every row is held out once at most; `problem`: data, weights and believed model of all rows;
    `noise`, `generic` (n, n): covariances of the noise and of a generic misfit (a smooth Gaussian process) of size 1,
    kPa^2; `fitting` (n, n): covariance that weights the fits, kPa^2; `errors`: noise of the curves, from which
    `noise` follows.
    """

    unit: str
    folds: tuple[Fold, ...]
    problem: FitProblem
    noise: FloatArray
    generic: FloatArray
    fitting: FloatArray
    errors: CurveNoise


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of a hypothesis' predictions of held-out rows, by fold (set of rows held out together) and in all.

    `rms`: root mean square error by name of the fold, kPa; `chi`: root mean square of the error over its standard
    deviation, all folds together; NaN without predictions; `misfits`: half the sum of squared whitened errors, by name
    of the fold, dimensionless; `rms_all`: root mean square error of all folds together, kPa; NaN without predictions.
    """

    rms: dict[str, float]
    chi: float
    misfits: dict[str, float]
    rms_all: float

    @property
    def total(self) -> float:
        """Sum of `misfits`, half the squared whitened errors, over all folds, dimensionless."""
        return sum(self.misfits.values())


def folds_of(
    experiment: MaterialExperiment, data: Data, settings: MaterialSettings = DEFAULT.material
) -> tuple[str, tuple[Fold, ...]]:
    """Return what is held out (a unit), and the folds: sets of rows that are held out in turn.

    `experiment`: its `hold_out` is the unit where it is given; else the first of mode, rate and specimen with several
    values; `data`: rows used. Result: `unit`: "mode", "rate", "specimen", or "part" where none has several; `folds`: at
    least one.
    """
    wanted = HELD_OUT if experiment.hold_out is None else (experiment.hold_out,)
    for unit in wanted:
        values = experiment.values(unit)
        if len(values) > 1 and not (unit == "rate" and len(_alike(values, settings.same_rate)) < 2):
            sets: Sequence[Sequence[object]] = (
                _alike(values, settings.same_rate) if unit == "rate" else [[v] for v in values]
            )
            if unit == "specimen" and len(values) > settings.most_folds:
                sets = [values[i :: settings.most_folds] for i in range(settings.most_folds)]
            own = np.array([str(getattr(curve, unit)) for curve in data.curves])[data.curve_of]
            return unit, tuple(Fold(_named(unit, s), np.isin(own, [str(v) for v in s])) for s in sets)
    beyond = data.arc > settings.part
    return "part", (Fold("the last part of the load history", beyond),)


def _alike(rates: Sequence[object], same: float) -> list[list[object]]:
    """Return strain rates (1/s) in ascending order, in sets of which each rate is below `same` times the one before."""
    sets: list[list[object]] = []
    for rate in sorted(float(str(r)) for r in rates):
        if sets and rate < same * float(str(sets[-1][-1])):
            sets[-1].append(rate)
        else:
            sets.append([rate])
    return sets


def _named(unit: str, values: Sequence[object]) -> str:
    if unit == "rate":
        return ", ".join(f"{float(str(v)):g}/s" for v in values)
    return ", ".join(str(v) for v in values)


def held_out_errors(bench: ProofInput, fit: MaterialFit, *, patch_share: float | None = None) -> HeldOutErrors:
    """Return the errors of a hypothesis on every fold, each predicted by a fit to all other rows.

    `bench`: rows, covariances and folds; `fit`: fit to all rows; its parameters are the first guess; `patch_share`:
    size, over the stress, of a generic misfit (Gaussian process) that is conditioned on the fitted rows and added to
    the prediction; none where absent. Without it, the believed law is fitted with independent rows, as a user would do:
    with correlated errors a wrong law would be fitted to slopes alone. Result: NaN where no fold could be predicted.
    """
    data = bench.problem.data
    errors, pointwise, sizes, misfits = [], [], {}, {}
    for fold in bench.folds:
        known, left_out = np.flatnonzero(~fold.held_out), np.flatnonzero(fold.held_out)
        if not len(left_out) or len(known) <= len(fit.x):
            continue
        own = bench.fitting[np.ix_(known, known)]
        if not fit.parts and patch_share is None:
            own = np.diag(np.diag(own))
        weights = weights_of(own, bench.generic[np.ix_(known, known)])
        problem = replace(bench.problem, data=data.part(~fold.held_out), weights=weights)
        again = fitted(problem, fit.parts, [fit.x], fit.share if patch_share is None else patch_share)
        error = data.stress[left_out] - data.part(fold.held_out).modelled(again.model)
        if patch_share is not None:
            residual = problem.data.stress - problem.data.modelled(again.model)
            error = error - patched(bench.noise, bench.generic, patch_share, known, left_out, residual)
        # Where the law has no stress, the prediction is zero.
        error = np.where(np.isfinite(error), error, data.stress[left_out])
        own = bench.noise[np.ix_(left_out, left_out)]
        white = np.linalg.solve(np.linalg.cholesky(own), error)
        misfits[fold.name] = 0.5 * float(white @ white)
        pointwise.append(error / np.sqrt(np.diag(own)))
        errors.append(error)
        sizes[fold.name] = rms(error)
    if not errors:
        return HeldOutErrors({}, math.nan, {}, math.nan)
    return HeldOutErrors(sizes, rms(np.concatenate(pointwise)), misfits, rms(np.concatenate(errors)))
