"""Understated noise: what the best fit leaves is white, and larger than the stated noise.

A wrong model leaves smooth residuals. Their part orthogonal to all nuisances, to the fit's own parameters and to the
generic rival (any smooth change over markers, load and time) is noise, whatever the model misses. Its size is compared
with the statement by the evidence for one factor s on the standard deviations of a channel:

    log p(q | s) = -q / (2 s^2) - n log s,      log s ~ N(0, spread) as stated, U(0, log(largest)) understated,

with q the sum of squares and n its degrees of freedom. The sum is n times a median over the markers, so that single
markers that slip or are exchanged do not count as noise.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.fit import Fit, FitTarget
from tissuereg.diagnosis.noise import Noise, scale_evidence
from tissuereg.diagnosis.settings import NoiseSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment

#: Verdict of data that are consistent with the model, but not with the stated noise.
UNDERSTATED = "understated-noise"


@dataclass(frozen=True)
class UnderstatedNoise:
    """A channel whose noise is larger than stated.

    Attributes
    ----------
    channel : str
        ``markers`` or ``forces``.
    stated, estimated : float
        Standard deviation of a coordinate, mm, or of a force component, mN.
    factor : float
        The estimated over the stated one.
    log_bayes_factor : float
        Evidence for the larger noise against the stated one, nats.
    """

    channel: str
    stated: float
    estimated: float
    factor: float
    log_bayes_factor: float

    @property
    def unit(self) -> str:
        """Unit of the standard deviations."""
        return "mm" if self.channel == "markers" else "mN"

    @property
    def sentence(self) -> str:
        """The same in words."""
        return (
            f"The noise of the {self.channel} is understated: stated are {self.stated:.3g} {self.unit}, but what the "
            f"model leaves is white and {self.factor:.2g} times as large, {self.estimated:.3g} {self.unit} (log Bayes "
            f"factor {self.log_bayes_factor:.0f})"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the channel as plain data for JSON."""
        return {**asdict(self), "unit": self.unit, "sentence": self.sentence}


def larger_noise(target: FitTarget, left: Fit, generic: FloatArray, settings: NoiseSettings) -> Noise | None:
    """Return the noise that explains what a fit leaves where it is larger than that of the target; None where not.

    `left`: the best fit; `generic` (p, size): whitened columns of the generic rival.
    """
    layout, noise = target.bench.layout, target.noise
    slopes = target.white(left.jacobian) * left.deviation[:, None]
    basis = _basis(np.concatenate([target.null.nuisances, slopes, generic]))
    squares = (left.residual - (left.residual @ basis.T) @ basis) ** 2
    freedom = np.where(layout.seen, 1.0 - (basis**2).sum(axis=0), 0.0)
    markers = layout.of_markers()
    of_markers = _factor(squares, freedom, _rows_of_markers(layout), settings)
    of_forces = _factor(squares, freedom, [~markers], settings)
    if of_markers is None and of_forces is None:
        return None
    by_markers, evidence = of_markers or (1.0, noise.evidence)
    by_forces, force_evidence = of_forces or (1.0, 0.0)
    return replace(
        noise,
        marker_std=by_markers * noise.marker_std,
        common_std=by_markers * noise.common_std,
        force_std=by_forces * noise.force_std,
        evidence=evidence,
        force_evidence=force_evidence,
    )


def understated(experiment: Experiment, noise: Noise, settings: NoiseSettings) -> tuple[UnderstatedNoise, ...]:
    """Return the channels whose noise, as found in the data, exceeds what the experiment states."""
    rows = [("markers", float(experiment.marker_std), float(np.median(noise.marker_std)), noise.evidence)]
    if experiment.force_std is not None:
        rows.append(("forces", experiment.force_std, noise.force_std, noise.force_evidence))
    return tuple(
        UnderstatedNoise(channel, stated, found, found / stated, evidence)
        for channel, stated, found, evidence in rows
        if found >= settings.least_factor * stated and evidence >= settings.least_evidence
    )


def _factor(
    squares: FloatArray, freedom: FloatArray, groups: list[BoolArray], settings: NoiseSettings
) -> tuple[float, float] | None:
    """Return the factor on the standard deviation that a left-over shows, and its evidence; None where it shows none.

    `squares`, `freedom` (size,): squared left-over and degrees of freedom of every number; `groups`: masks of the
    numbers that are pooled before the median is taken.
    """
    sums = [(float(squares[rows].sum()), float(freedom[rows].sum())) for rows in groups]
    enough = [(q, n) for q, n in sums if n >= settings.least_freedom]
    if not enough:
        return None
    variance = float(np.median([q / chi2.median(n) for q, n in enough]))
    total = sum(n for _, n in enough)
    evidence = scale_evidence(total * variance, total, settings)
    factor = float(np.sqrt(variance))
    return (factor, evidence) if factor >= settings.least_factor and evidence >= settings.least_evidence else None


def _rows_of_markers(layout: SignalLayout) -> list[BoolArray]:
    groups = []
    for number in range(len(layout.marker_names)):
        rows = np.zeros(layout.size, bool)
        for part in layout.parts:
            part.markers(rows)[:, number] = True
        groups.append(rows)
    return groups


def _basis(rows: FloatArray) -> FloatArray:
    """Return orthonormal rows that span the same space as the given ones (k, size)."""
    rows = rows[np.linalg.norm(rows, axis=1) > 0.0]
    _, sizes, basis = np.linalg.svd(rows / np.linalg.norm(rows, axis=1)[:, None], full_matrices=False)
    return np.asarray(basis[sizes > 1e-6 * sizes[0]] if len(sizes) else basis)
