"""Proof on what was never fitted: a mode, a rate, a specimen, or the rest of a lone curve."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.material.data import BoolArray, Data
from tissuereg.diagnose.material.fit import Fit, Problem, fitted
from tissuereg.diagnose.material.weights import block, patched, weights_of
from tissuereg.material_experiment import HELD_OUT, MaterialExperiment

#: Specimens are left out in so many sets at most.
_MAX_FOLDS = 4
#: A lone curve is fitted up to here and foretold beyond, in progress along its load history.
_PART = 0.8
#: Rates of a ratio below this are left out together: one would be a copy of the other.
_SAME_RATE = 1.5


@dataclass(frozen=True, eq=False)
class Fold:
    """What is left out at once.

    Attributes
    ----------
    name : str
        Such as ``compression``.
    held_out : ndarray of bool, shape (n,)
        Rows left out.
    """

    name: str
    held_out: BoolArray


@dataclass(frozen=True, eq=False)
class Bench:
    """All that a proof needs.

    Attributes
    ----------
    unit : str
        ``mode``, ``rate``, ``specimen`` or ``part``.
    folds : tuple of Fold
        Every row is left out once at most.
    problem : Problem
        Of all rows.
    noise, generic : ndarray of float64, shape (n, n)
        Covariances, kPa^2.
    repeats : int
        Curves that repeat another one: how well the noise is known.
    fitting : ndarray of float64, shape (n, n), optional
        Covariance that fits are weighted by, in place of `noise`.
    """

    unit: str
    folds: tuple[Fold, ...]
    problem: Problem
    noise: FloatArray
    generic: FloatArray
    repeats: int = 0
    fitting: FloatArray | None = None


@dataclass(frozen=True)
class HeldOutErrors:
    """How well a hypothesis foretells what was left out.

    Attributes
    ----------
    rms : dict of str to float
        kPa, by fold.
    chi : float
        Root mean square of the error over its standard deviation, all folds together.
    misfits : dict of str to float
        Half the sum of squared whitened errors, by fold.
    rms_all : float
        kPa, all folds together.
    """

    rms: dict[str, float]
    chi: float
    misfits: dict[str, float]
    rms_all: float

    @property
    def total(self) -> float:
        """Misfit of all folds together."""
        return sum(self.misfits.values())


def folds_of(experiment: MaterialExperiment, data: Data) -> tuple[str, tuple[Fold, ...]]:
    """Return what is left out in turn.

    Parameters
    ----------
    experiment : MaterialExperiment
        Its `hold_out` decides where it is given; else modes, then rates, then specimens, whatever there are two of.
    data : Data
        Rows used.

    Returns
    -------
    unit : str
        As in `Bench`.
    folds : tuple of Fold
        At least one.
    """
    wanted = HELD_OUT if experiment.hold_out is None else (experiment.hold_out,)
    for unit in wanted:
        values = experiment.values(unit)
        if len(values) > 1 and not (unit == "rate" and len(_alike(values)) < 2):
            sets: Sequence[Sequence[object]] = _alike(values) if unit == "rate" else [[v] for v in values]
            if unit == "specimen" and len(values) > _MAX_FOLDS:
                sets = [values[i::_MAX_FOLDS] for i in range(_MAX_FOLDS)]
            own = np.array([str(getattr(curve, unit)) for curve in data.curves])[data.curve_of]
            return unit, tuple(Fold(_named(unit, s), np.isin(own, [str(v) for v in s])) for s in sets)
    beyond = data.arc > _PART
    return "part", (Fold("the last part of the load history", beyond),)


def _alike(rates: Sequence[object]) -> list[list[object]]:
    """Return rates in sets that lie close together."""
    sets: list[list[object]] = []
    for rate in sorted(float(str(r)) for r in rates):
        if sets and rate < _SAME_RATE * float(str(sets[-1][-1])):
            sets[-1].append(rate)
        else:
            sets.append([rate])
    return sets


def _named(unit: str, values: Sequence[object]) -> str:
    if unit == "rate":
        return ", ".join(f"{float(str(v)):g}/s" for v in values)
    return ", ".join(str(v) for v in values)


def held_out_errors(bench: Bench, fit: Fit, *, patch_share: float | None = None) -> HeldOutErrors:
    """Fit a hypothesis again without each fold and compare what it foretells.

    Parameters
    ----------
    bench : Bench
        Rows, covariances and folds.
    fit : Fit
        Of all rows; where the search begins.
    patch_share : float, optional
        Size of a generic misfit that is learnt from the fitted rows and carried over; none where absent. Without it,
        what is believed is fitted as a user would, every row by itself: under lasting errors a wrong law would be
        fitted to its slopes alone.

    Returns
    -------
    HeldOutErrors
        Errors.
    """
    data = bench.problem.data
    errors, pointwise, rms, misfits = [], [], {}, {}
    for fold in bench.folds:
        known, left_out = np.flatnonzero(~fold.held_out), np.flatnonzero(fold.held_out)
        if not len(left_out) or len(known) <= len(fit.x):
            continue
        own = block(bench.noise if bench.fitting is None else bench.fitting, known)
        if not fit.forms and patch_share is None:
            own = np.diag(np.diag(own))
        weights = weights_of(own, block(bench.generic, known))
        problem = replace(bench.problem, data=data.part(~fold.held_out), weights=weights)
        again = fitted(problem, fit.forms, [fit.x], fit.share if patch_share is None else patch_share)
        error = data.stress[left_out] - data.part(fold.held_out).modelled(again.model)
        if patch_share is not None:
            left = problem.data.stress - problem.data.modelled(again.model)
            error = error - patched(bench.noise, bench.generic, patch_share, known, left_out, left)
        # A law that has no stress there is as wrong as one that says nothing.
        error = np.where(np.isfinite(error), error, data.stress[left_out])
        own = block(bench.noise, left_out)
        white = np.linalg.solve(np.linalg.cholesky(own), error)
        misfits[fold.name] = 0.5 * float(white @ white)
        pointwise.append(error / np.sqrt(np.diag(own)))
        errors.append(error)
        rms[fold.name] = float(np.sqrt(np.mean(error**2)))
    if not errors:
        return HeldOutErrors({}, math.nan, {}, math.nan)
    point, every = np.concatenate(pointwise), np.concatenate(errors)
    return HeldOutErrors(rms, float(np.sqrt(np.mean(point**2))), misfits, float(np.sqrt(np.mean(every**2))))
