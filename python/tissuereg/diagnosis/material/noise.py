"""Covariances of curves, and whitening by them: the noise, with or without a generic misfit.

The noise is white noise of a stress, a factor for each specimen, and correlated errors along a curve. The generic
misfit is a Gaussian process in strain, progress and rate, common to all curves of a mode, whose standard deviation is
`share` times the stress. In the eigenvectors U of its covariance, whitened by the noise, with eigenvalues Lambda, the
whitening for any share is a division:

    C(share) = L U (1 + share^2 Lambda) U^T L^T,      L L^T = noise
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
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
    """Return the noise of an experiment's curves: as repeated curves show it, weighed with typical values."""
    std = np.array([_white(curve, experiment.stress_std, settings.least_noise) for curve in experiment.curves])
    sums, repeats, prior = np.zeros(2), 0, settings.prior_repeats
    for group in _repeated(experiment.curves):
        sums += np.array(_spread([experiment.curves[i] for i in group], std[group])) * (len(group) - 1)
        repeats += len(group) - 1
    usual = np.array([settings.usual_factor**2, settings.usual_along**2])
    factor, along = np.sqrt((sums + prior * usual) / (repeats + prior)).tolist()
    return CurveNoise(std, factor, along, repeats)


def covariance(data: Data, noise: CurveNoise, settings: MaterialSettings) -> FloatArray:
    """Return the covariance (n, n) of measured stresses about a correct law, kPa^2."""
    level, specimens = data.level, data.names("specimen")
    total = np.diag(noise.std[data.curve_of] ** 2)
    lasting = (1.0 - settings.rough) * _near(data.arc, settings.along_length) + settings.rough * np.eye(len(level))
    total += noise.along**2 * np.outer(level, level) * lasting * _same(data.curve_of)
    if len(set(specimens)) > 1:
        total += noise.factor**2 * np.outer(data.stress, data.stress) * _same(specimens)
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
        """Return residuals, (n,) or (n, k) in kPa, whitened; `share`: size of the generic misfit over the stress."""
        turned = self.whitener @ residual
        size = np.sqrt(1.0 + share**2 * self.spectrum)
        return np.asarray(turned / (size if turned.ndim == 1 else size[:, None]))

    def log_size(self, share: float) -> float:
        """Return half the log determinant of noise with a generic misfit of size `share`, over that of noise."""
        return 0.5 * float(np.log1p(share**2 * self.spectrum).sum())


def weights_of(noise: FloatArray, generic: FloatArray) -> Weights:
    """Return the whitening for covariances (n, n) of noise and of a generic misfit of size 1 over the stress, kPa^2."""
    inverse = np.linalg.inv(np.linalg.cholesky(noise))
    spectrum, vectors = np.linalg.eigh(inverse @ generic @ inverse.T)
    return Weights(vectors.T @ inverse, np.maximum(spectrum, 0.0))


def generic_covariance(data: Data, settings: MaterialSettings = DEFAULT.material) -> FloatArray:
    """Return the covariance, shape (n, n), kPa^2, of a generic misfit of size 1 over the stress at the n rows."""
    same, rough = _same(data.names("mode")), settings.rough * np.eye(len(data.stress))
    path = 0.7 * _near(data.arc, settings.misfit_arc) + 0.3 * _near(data.arc, settings.misfit_short_arc)
    alike = _near(data.strain, settings.misfit_strain) * path * _near(data.log_rate, settings.misfit_rate)
    return np.asarray(np.outer(data.level, data.level) * ((1.0 - settings.rough) * alike * same + rough))


def _near(values: FloatArray, length: float) -> FloatArray:
    """Return the correlation (n, n) of a Gaussian process of a correlation length at places `values` (n,)."""
    return np.asarray(np.exp(-0.5 * ((values[:, None] - values[None, :]) / length) ** 2))


def _same(values: Any) -> BoolArray:
    """Return whether the values (n,) of two rows are the same, (n, n)."""
    return np.asarray(values[:, None] == values[None, :])


def _white(curve: Curve, given: float | None, least: float) -> float:
    """Return the white noise of a stress, kPa, by the difference of rows from a cubic through their four neighbours."""
    if given is not None:
        return given
    measured = np.isfinite(curve.stress)
    place, stress = path_arc(curve)[measured], curve.stress[measured]
    peak = float(np.abs(stress).max())
    if len(stress) < 7:
        return max(least * peak, 0.01 * peak)
    # Adding the row number separates rows at equal progress.
    place = place + np.linspace(0.0, 0.2, len(place))
    differences = []
    for i in range(2, len(stress) - 2):
        others = [i - 2, i - 1, i + 1, i + 2]
        weights = _cubic_weights(place[others] - place[i])
        differences.append((stress[i] - weights @ stress[others]) / np.sqrt(1.0 + weights @ weights))
    # The median is robust against the few corners of a path.
    return max(least * peak, 1.4826 * float(np.median(np.abs(differences))))


def _cubic_weights(offsets: FloatArray) -> FloatArray:
    """Return the weights (4,) of the values at four `offsets` (4,) in the cubic through them, evaluated at 0."""
    others = [np.delete(offsets, i) for i in range(4)]
    return np.array([np.prod(-rest / (one - rest)) for one, rest in zip(offsets, others, strict=True)])


def _repeated(curves: Sequence[Curve]) -> list[list[int]]:
    """Return sets of indices of curves that repeat each other; curves without a repeat are left out."""
    sets: list[list[int]] = []
    for index, curve in enumerate(curves):
        members = next((one for one in sets if _repeats(curves[one[0]], curve)), [])
        if not members:
            sets.append(members)
        members.append(index)
    return [members for members in sets if len(members) > 1]


def _repeats(one: Curve, other: Curve) -> bool:
    """Return whether two curves have one mode, the same or unknown rates, and similar strains along their histories."""
    rates = (np.isnan(one.rate) and np.isnan(other.rate)) or abs(one.rate - other.rate) < 0.1 * one.rate
    places = np.linspace(0.05, 1.0, 20)
    paths = [np.interp(places, path_arc(c), c.strains) for c in (one, other)]
    apart = np.abs(paths[0] - paths[1]).max()
    return one.mode == other.mode and bool(rates and apart < 0.15 * np.abs(one.strains).max())


def _spread(curves: Sequence[Curve], std: FloatArray) -> tuple[float, float]:
    """Return the variances of specimens' factor and of correlated errors over the stress; `std`: white noise, kPa."""
    places = np.linspace(0.05, 1.0, 40)
    # Stress at equal strain, so that small differences of a machine's stroke do not count as errors of the stress.
    common = np.mean([np.interp(places, path_arc(c), c.strains) for c in curves], axis=0)
    stresses = np.array([_at(c, places, common) for c in curves])
    mean = stresses.mean(axis=0)
    level = np.abs(mean) + 0.1 * np.abs(mean).max()
    factors = stresses @ mean / (mean @ mean)
    rest = (stresses - factors[:, None] * mean) / level
    white = np.mean(std**2) * np.mean(1.0 / level**2)
    return float(factors.var(ddof=1)), max(float((rest**2).mean()) * len(curves) / (len(curves) - 1) - white, 0.0)


def _at(curve: Curve, places: FloatArray, strains: FloatArray) -> FloatArray:
    """Return a curve's stresses (k,) at progress `places` (k,), moved along its slope to `strains` (k,)."""
    measured = np.isfinite(curve.stress)
    arc = path_arc(curve)[measured]
    stress, own = np.interp(places, arc, curve.stress[measured]), np.interp(places, path_arc(curve), curve.strains)
    slope = np.gradient(stress, own) if np.all(np.diff(own) > 0) or np.all(np.diff(own) < 0) else np.zeros(len(places))
    return np.asarray(stress + slope * (strains - own))
