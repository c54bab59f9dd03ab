"""Understated noise: what the best fit leaves is like noise, and larger than the stated one.

The part of a residual orthogonal to all nuisances, to the fit's own parameters and to the generic rival (any smooth
change) is noise, whatever the model misses. Its size is compared with the statement by the evidence for one factor s
on the standard deviations of a channel:

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
from tissuereg.diagnosis.patterns import orthonormal
from tissuereg.diagnosis.settings import NoiseSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment

#: Verdict of data that are consistent with the model, but not with the stated noise.
UNDERSTATED = "understated-noise"

#: The noise of both channels is estimated again until it changes by less than this share, or so many times.
_SETTLED, _MOST_ROUNDS = 0.01, 30

#: Variances over the assumed one are not taken for smaller: data that are simulated may have no noise.
_LEAST_VARIANCE = 1e-4


@dataclass(frozen=True)
class UnderstatedNoise:
    """A channel whose noise is larger than stated.

    `channel`: ``markers`` or ``forces``; `stated`, `estimated`: standard deviation of a coordinate, mm, or of a force
    component, mN; `factor`: the estimated over the stated one; `log_bayes_factor`: evidence for the larger one, nats.
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
            f"The noise of the {self.channel} is understated: {self.stated:.3g} {self.unit} are stated, "
            f"{self.estimated:.3g} {self.unit} are found, {self.factor:.2g} times as much (log Bayes factor "
            f"{self.log_bayes_factor:.0f})"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the channel as plain data for JSON."""
        return {**asdict(self), "unit": self.unit, "sentence": self.sentence}


def larger_noise(target: FitTarget, left: Fit, generic: FloatArray, settings: NoiseSettings) -> Noise | None:
    """Return the noise that explains what a fit leaves where it is larger than that of the target; None where not.

    `left`: the best fit; `generic` (p, size): whitened columns of the generic rival.
    """
    layout, noise = target.bench.layout, target.noise
    rows = np.concatenate([target.null.nuisances, target.slopes(left), generic])
    of_markers, of_forces = _channels(rows, left.residual, layout, settings)
    # Rest frames may already have shown a part of what is not stated.
    before = float(np.median(noise.marker_std)) / target.bench.experiment.marker_std
    by_markers, evidence = _larger(of_markers, settings, before) or (1.0, noise.evidence)
    by_forces, force_evidence = _larger(of_forces, settings) or (1.0, noise.force_evidence)
    if by_markers == by_forces == 1.0:
        return None
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


@dataclass(frozen=True)
class _NoiseSize:
    """The noise of a channel: its `variance` over the assumed one, from so many degrees of `freedom`; 0 without any."""

    variance: float
    freedom: float


def _channels(
    rows: FloatArray, residual: FloatArray, layout: SignalLayout, settings: NoiseSettings
) -> tuple[_NoiseSize, _NoiseSize]:
    """Return the noise of markers and forces in what the rows (k, size) cannot change of a residual (size,)."""
    number = np.full(layout.size, -1)
    for part in layout.parts:
        part.markers(number)[:] = np.arange(part.n_markers)[:, None]
    markers, groups = number >= 0, [number == i for i in range(len(layout.marker_names))]
    # Rows that act on both channels carry the noise of one into the left-over of the other, unless both are in units of
    # their own noise: they are estimated again in these units until they stay.
    span, scale = orthonormal(rows), np.ones(layout.size)
    of_markers = of_forces = _NoiseSize(1.0, 0.0)
    for _ in range(_MOST_ROUNDS):
        basis, white = np.linalg.qr((span / scale).T)[0].T, residual / scale
        squares = (scale * (white - (white @ basis.T) @ basis)) ** 2
        freedom = np.where(layout.seen, 1.0 - (basis**2).sum(axis=0), 0.0)
        of_markers = _pooled(squares, freedom, groups, settings)
        of_forces = _pooled(squares, freedom, [~markers], settings)
        last, scale = scale, np.sqrt(np.where(markers, of_markers.variance, of_forces.variance))
        if np.allclose(scale, last, rtol=_SETTLED):
            break
    return of_markers, of_forces


def _pooled(squares: FloatArray, freedom: FloatArray, groups: list[BoolArray], settings: NoiseSettings) -> _NoiseSize:
    """Return the noise of a channel from squares and degrees of freedom (size,), pooled in masks before the median."""
    sums = [(float(squares[rows].sum()), float(freedom[rows].sum())) for rows in groups]
    enough = [(q, n) for q, n in sums if n >= settings.least_freedom]
    if not enough:
        return _NoiseSize(1.0, 0.0)
    variance = float(np.median([q / chi2.median(n) for q, n in enough]))
    return _NoiseSize(max(variance, _LEAST_VARIANCE), sum(n for _, n in enough))


def _larger(found: _NoiseSize, settings: NoiseSettings, before: float = 1.0) -> tuple[float, float] | None:
    """Return the factor on the assumed deviation, and the evidence against the stated one; None if not larger."""
    factor, power = float(np.sqrt(found.variance)), found.freedom * found.variance
    if factor < settings.least_factor or scale_evidence(power, found.freedom, settings) < settings.least_evidence:
        return None
    return factor, scale_evidence(power * before**2, found.freedom, settings)
