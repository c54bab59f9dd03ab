"""Covariances of curves, and whitening by them: the noise, with or without a generic misfit.

The noise is white noise of a stress, a factor for each specimen, and correlated errors along a curve. The generic
misfit is a Gaussian process in strain, progress and rate, common to all curves of a mode, whose standard deviation is
`share` times the stress. In the eigenvectors U of its covariance, whitened by the noise, with eigenvalues Lambda, the
whitening for any share is a division:

    C(share) = L U (1 + share^2 Lambda) U^T L^T,      L L^T = noise
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.material.data import Data, path_arc
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True, eq=False)
class CurveNoise:
    """Standard deviations of the errors of measured stress curves.

    `std` (n_curves,): white noise of one stress, kPa; `factor`: standard deviation of the factor by which the stresses
    of specimens differ; `along`: correlated error along a curve, over its stress; `repeats`: number of curves in sets
    of repeated ones, minus the number of such sets.
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
    lasting = (1.0 - settings.rough) * _near(data.arc, settings.along_length) + settings.rough * np.eye(len(level))
    total += noise.along**2 * np.outer(level, level) * lasting * together
    if len(set(specimens)) > 1:
        signed = data.stress
        total += noise.factor**2 * np.outer(signed, signed) * (specimens[:, None] == specimens[None, :])
    return np.asarray(total)


@dataclass(frozen=True, eq=False)
class Weights:
    """Whitening of measured stresses, for any size of a generic misfit (a smooth Gaussian process).

    With noise covariance ``L L^T`` and generic covariance G, ``L^-1 G L^-T = U Lambda U^T``, an eigendecomposition:
    `whitener` (n, n): ``U^T L^-1``, 1/kPa; `spectrum` (n,): diagonal of ``Lambda``.
    """

    whitener: FloatArray
    spectrum: FloatArray

    def whitened(self, residual: FloatArray, share: float = 0.0) -> FloatArray:
        """Return residuals, (n,) or (n, k) in kPa, over their standard deviations and without correlation.

        `share`: size of the generic misfit over the stress.
        """
        turned = self.whitener @ residual
        size = np.sqrt(1.0 + share**2 * self.spectrum)
        return np.asarray(turned / (size if turned.ndim == 1 else size[:, None]))

    def log_size(self, share: float) -> float:
        """Return half the log of the determinant of noise plus generic covariance (size `share`) over that of noise."""
        return 0.5 * float(np.log1p(share**2 * self.spectrum).sum())


def weights_of(noise: FloatArray, generic: FloatArray) -> Weights:
    """Return the whitening for a noise covariance and the covariance of a generic misfit.

    `noise`, `generic` (n, n): kPa^2; `generic` for a misfit of size 1 over the stress. It costs one Cholesky factor and
    one eigenvalue problem.
    """
    factor = np.linalg.cholesky(noise)
    inverse = np.linalg.inv(factor)
    spectrum, vectors = np.linalg.eigh(inverse @ generic @ inverse.T)
    return Weights(vectors.T @ inverse, np.maximum(spectrum, 0.0))


def generic_covariance(data: Data, settings: MaterialSettings = DEFAULT.material) -> FloatArray:
    """Return the covariance, shape (n, n), kPa^2, of a generic misfit of size 1 over the stress at the n rows."""
    modes = np.array(data.modes)
    path = 0.7 * _near(data.arc, settings.misfit_arc) + 0.3 * _near(data.arc, settings.misfit_short_arc)
    alike = _near(data.strain, settings.misfit_strain) * path * _near(data.log_rate, settings.misfit_rate)
    alike = (1.0 - settings.rough) * alike * (modes[:, None] == modes[None, :]) + settings.rough * np.eye(len(modes))
    return np.asarray(np.outer(data.level, data.level) * alike)


def patched(
    noise: FloatArray, generic: FloatArray, share: float, known: IntArray, left_out: IntArray, residual: FloatArray
) -> FloatArray:
    """Return the posterior mean of a generic misfit at some rows, given the residual at others.

    `noise`, `generic` (n, n): covariances, kPa^2; `share`: size of the misfit over the stress; `known`, `left_out`:
    indices of the rows with and without a residual; `residual` (n_known,): measured minus modelled there, kPa. Result:
    (n_left_out,), to be added to the model, kPa.
    """
    own = noise[np.ix_(known, known)] + share**2 * generic[np.ix_(known, known)]
    across = share**2 * generic[np.ix_(left_out, known)]
    return np.asarray(across @ np.linalg.solve(own, residual))


def _near(values: FloatArray, length: float) -> FloatArray:
    """Return the correlation (n, n) of a Gaussian process of a correlation length at places `values` (n,)."""
    return np.asarray(np.exp(-0.5 * ((values[:, None] - values[None, :]) / length) ** 2))


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
