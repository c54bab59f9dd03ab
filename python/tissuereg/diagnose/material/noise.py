"""How far a curve may lie off by itself: noise of one stress, one specimen's factor, errors that last along a curve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.material.data import Data, path_arc
from tissuereg.material_experiment import Curve, MaterialExperiment

#: Noise of one stress over the curve's peak is not taken for less: load cells and digitised plots do no better.
LEAST_NOISE = 1e-3
#: What testing machines repeat, where no curves are repeated: errors along a curve over its stress, and one specimen's
#: factor. They weigh like `_PRIOR_REPEATS` repeats beside measured spreads.
USUAL_ALONG = 0.02
USUAL_FACTOR = 0.05
_PRIOR_REPEATS = 1.0
#: Length, in progress along the load history, over which an error of a curve lasts.
ALONG_LENGTH = 0.25
#: Share of such an error's variance that lasts no longer than a row: corners of a path, and what is not smooth.
ROUGH = 0.2


@dataclass(frozen=True, eq=False)
class Noise:
    """Sizes of what is no misfit of the law.

    Attributes
    ----------
    std : ndarray of float64, shape (n_curves,)
        White noise of one stress, kPa.
    factor : float
        Standard deviation of the factor between specimens, dimensionless.
    along : float
        Standard deviation of an error that lasts along a curve, over its stress.
    repeats : int
        Curves that repeat another one, less the number of such sets.
    """

    std: FloatArray
    factor: float
    along: float
    repeats: int


def noise_of(experiment: MaterialExperiment) -> Noise:
    """Estimate the noise of an experiment.

    White noise is what is left of every row by a cubic through its four neighbours along the load history. Curves of
    one mode and rate repeat each other: after their common mean, factors give the spread of specimens, the rest the
    errors along a curve.

    Parameters
    ----------
    experiment : MaterialExperiment
        With its curves.

    Returns
    -------
    Noise
        Where nothing is repeated, usual figures stand in.
    """
    std = np.array([_white(curve, experiment.stress_std) for curve in experiment.curves])
    factors, rests, repeats = 0.0, 0.0, 0
    for group in _repeated(experiment.curves):
        spread, rest = _spread([experiment.curves[i] for i in group], std[group])
        factors += spread * (len(group) - 1)
        rests += rest * (len(group) - 1)
        repeats += len(group) - 1
    weight = repeats + _PRIOR_REPEATS
    factor = np.sqrt((factors + _PRIOR_REPEATS * USUAL_FACTOR**2) / weight)
    along = np.sqrt((rests + _PRIOR_REPEATS * USUAL_ALONG**2) / weight)
    return Noise(std, float(factor), float(along), repeats)


def covariance(data: Data, noise: Noise) -> FloatArray:
    """Return the covariance of the stresses of an experiment whose law is right.

    Parameters
    ----------
    data : Data
        Rows used.
    noise : Noise
        Sizes.

    Returns
    -------
    ndarray of float64, shape (n, n)
        kPa^2.
    """
    level, specimens = data.level, np.array(data.specimens)
    total = np.diag(noise.std[data.curve_of] ** 2)
    together = data.curve_of[:, None] == data.curve_of[None, :]
    lasting = np.exp(-0.5 * ((data.arc[:, None] - data.arc[None, :]) / ALONG_LENGTH) ** 2)
    lasting = (1.0 - ROUGH) * lasting + ROUGH * np.eye(len(level))
    total += noise.along**2 * np.outer(level, level) * lasting * together
    if len(set(specimens)) > 1:
        signed = data.stress
        total += noise.factor**2 * np.outer(signed, signed) * (specimens[:, None] == specimens[None, :])
    return np.asarray(total)


def _white(curve: Curve, given: float | None) -> float:
    if given is not None:
        return given
    measured = np.isfinite(curve.stress)
    place, stress = path_arc(curve)[measured], curve.stress[measured]
    least = LEAST_NOISE * float(np.abs(stress).max())
    if len(stress) < 7:
        return max(least, 0.01 * float(np.abs(stress).max()))
    # A ladder in time: rows apart in progress and in number.
    place = place + np.linspace(0.0, 0.2, len(place))
    left = []
    for i in range(2, len(stress) - 2):
        others = [i - 2, i - 1, i + 1, i + 2]
        weights = _cubic_weights(place[others] - place[i])
        left.append((stress[i] - weights @ stress[others]) / np.sqrt(1.0 + weights @ weights))
    # The median is not moved by a few corners of the path.
    return max(least, 1.4826 * float(np.median(np.abs(left))))


def _cubic_weights(offsets: FloatArray) -> FloatArray:
    """Return the weights of the cubic through four points at the place 0."""
    weights = np.empty(4)
    for i in range(4):
        others = np.delete(offsets, i)
        weights[i] = np.prod(-others / (offsets[i] - others))
    return weights


def _repeated(curves: Sequence[Curve]) -> list[list[int]]:
    """Return sets of curves of one mode and, within a tenth, one rate and one largest strain."""
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
    """Return the variances of factors and of errors along curves, over the stress."""
    places = np.linspace(0.05, 1.0, 40)
    # Stress at equal strain along the way, so that a machine's small differences of stroke do not count as errors.
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
