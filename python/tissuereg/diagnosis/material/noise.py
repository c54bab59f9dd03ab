"""The noise model of curves: white noise of a stress, a factor for each specimen, correlated errors along a curve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.data import Data, path_arc
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True, eq=False)
class CurveNoise:
    """Standard deviations of the errors of measured stress curves.

    Attributes
    ----------
    std : ndarray of float64, shape (n_curves,)
        White noise of one stress, kPa.
    factor : float
        Standard deviation of the factor by which the stresses of specimens differ, dimensionless.
    along : float
        Correlated error along a curve, over its stress.
    repeats : int
        Number of curves in sets of repeated ones, minus the number of such sets.
    """

    std: FloatArray
    factor: float
    along: float
    repeats: int


def noise_of(experiment: MaterialExperiment, settings: MaterialSettings = DEFAULT.material) -> CurveNoise:
    """Return the estimated noise of the curves of an experiment.

    White noise is estimated from the difference between every row and a cubic through its four neighbours along the
    load history. Curves of one mode and rate repeat each other: the factors between them and their mean give the spread
    of specimens, the remaining differences the correlated errors along a curve. Typical values are returned where no
    curve is repeated.
    """
    std = np.array([_white(curve, experiment.stress_std, settings.least_noise) for curve in experiment.curves])
    factors, rests, repeats = 0.0, 0.0, 0
    for group in _repeated(experiment.curves):
        spread, rest = _spread([experiment.curves[i] for i in group], std[group])
        factors += spread * (len(group) - 1)
        rests += rest * (len(group) - 1)
        repeats += len(group) - 1
    weight = repeats + settings.prior_repeats
    factor = np.sqrt((factors + settings.prior_repeats * settings.usual_factor**2) / weight)
    along = np.sqrt((rests + settings.prior_repeats * settings.usual_along**2) / weight)
    return CurveNoise(std, float(factor), float(along), repeats)


def covariance(data: Data, noise: CurveNoise, settings: MaterialSettings = DEFAULT.material) -> FloatArray:
    """Return the covariance of measured stresses about a correct law, shape (n, n), in kPa^2.

    `data`: the n rows used; `noise`: standard deviations.
    """
    level, specimens = data.level, np.array(data.specimens)
    total = np.diag(noise.std[data.curve_of] ** 2)
    together = data.curve_of[:, None] == data.curve_of[None, :]
    lasting = np.exp(-0.5 * ((data.arc[:, None] - data.arc[None, :]) / settings.along_length) ** 2)
    lasting = (1.0 - settings.rough) * lasting + settings.rough * np.eye(len(level))
    total += noise.along**2 * np.outer(level, level) * lasting * together
    if len(set(specimens)) > 1:
        signed = data.stress
        total += noise.factor**2 * np.outer(signed, signed) * (specimens[:, None] == specimens[None, :])
    return np.asarray(total)


def _white(curve: Curve, given: float | None, least: float) -> float:
    if given is not None:
        return given
    measured = np.isfinite(curve.stress)
    place, stress = path_arc(curve)[measured], curve.stress[measured]
    least *= float(np.abs(stress).max())
    if len(stress) < 7:
        return max(least, 0.01 * float(np.abs(stress).max()))
    # Adding the row number separates rows at equal progress.
    place = place + np.linspace(0.0, 0.2, len(place))
    differences = []
    for i in range(2, len(stress) - 2):
        others = [i - 2, i - 1, i + 1, i + 2]
        weights = _cubic_weights(place[others] - place[i])
        differences.append((stress[i] - weights @ stress[others]) / np.sqrt(1.0 + weights @ weights))
    # The median is robust against the few corners of a path.
    return max(least, 1.4826 * float(np.median(np.abs(differences))))


def _cubic_weights(offsets: FloatArray) -> FloatArray:
    """Return the weights (4,) of the values at four `offsets` (4,) in the cubic through them, evaluated at 0."""
    weights = np.empty(4)
    for i in range(4):
        others = np.delete(offsets, i)
        weights[i] = np.prod(-others / (offsets[i] - others))
    return weights


def _repeated(curves: Sequence[Curve]) -> list[list[int]]:
    """Return sets of indices of curves that repeat each other; curves without a repeat are left out.

    They have one mode, rates that are unknown or differ by less than a tenth, and similar strains along the load
    history.
    """
    sets: list[list[int]] = []
    for index, curve in enumerate(curves):
        for members in sets:
            first = curves[members[0]]
            rates = (np.isnan(first.rate) and np.isnan(curve.rate)) or abs(first.rate - curve.rate) < 0.1 * first.rate
            if first.mode == curve.mode and rates and _similar_path(first, curve):
                members.append(index)
                break
        else:
            sets.append([index])
    return [members for members in sets if len(members) > 1]


def _similar_path(one: Curve, other: Curve) -> bool:
    largest = np.abs(one.strains).max()
    places = np.linspace(0.05, 1.0, 20)
    paths = [np.interp(places, path_arc(c), c.strains) for c in (one, other)]
    return bool(np.abs(paths[0] - paths[1]).max() < 0.15 * largest)


def _spread(curves: Sequence[Curve], std: FloatArray) -> tuple[float, float]:
    """Return the variance of the factor between specimens and that of correlated errors along curves, over the stress.

    `curves`: measured curves that repeat each other; `std` (n_curves,): white noise of each, kPa.
    """
    places = np.linspace(0.05, 1.0, 40)
    # Stress at equal strain, so that small differences of a machine's stroke do not count as errors of the stress.
    common = np.mean([np.interp(places, path_arc(c), c.strains) for c in curves], axis=0)
    stresses = np.array([_at(c, places, common) for c in curves])
    mean = stresses.mean(axis=0)
    level = np.abs(mean) + 0.1 * np.abs(mean).max()
    factors = stresses @ mean / (mean @ mean)
    rest = (stresses - factors[:, None] * mean) / level
    white = np.mean(std**2) * np.mean(1.0 / level**2)
    n = len(curves)
    along = max(float((rest**2).mean()) * n / (n - 1) - float(white), 0.0)
    return float(factors.var(ddof=1)), along


def _at(curve: Curve, places: FloatArray, strains: FloatArray) -> FloatArray:
    measured = np.isfinite(curve.stress)
    arc = path_arc(curve)[measured]
    stress = np.interp(places, arc, curve.stress[measured])
    own = np.interp(places, path_arc(curve), curve.strains)
    slope = np.gradient(stress, own) if np.all(np.diff(own) > 0) or np.all(np.diff(own) < 0) else np.zeros(len(places))
    return np.asarray(stress + slope * (strains - own))
