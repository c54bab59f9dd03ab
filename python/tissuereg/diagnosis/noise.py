"""The noise of the measurement: its estimation from rest frames and holds, whitening by it, and understated noise.

A frame of markers is split into its mean (motion of the camera) and the deviations from it (each marker's own noise).
Both are first-order autoregressive in time; noise of forces is white. The stated standard deviations are kept unless a
chi-square test on frames without change of load contradicts them. Whitened noise is uncorrelated with unit variance.

The part of a fit's residual orthogonal to all nuisances, to the fit's own parameters and to the generic rival (any
smooth change) is noise, whatever the model misses. Noise is understated where that is like noise and larger than the
stated one, by the evidence for one factor s on the standard deviations of a channel:

    log p(q | s) = -q / (2 s^2) - n log s,      log s ~ N(0, spread) as stated, U(0, log(largest)) understated,

with q the sum of squares and n its degrees of freedom. The sum is n times a median over the markers, so that single
markers that slip or are exchanged do not count as noise.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.settings import DEFAULT, NoiseSettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout, orthonormal
from tissuereg.errors import NoiseError
from tissuereg.experiment.experiment import Experiment

#: Verdict of data that are consistent with the model, but not with the stated noise.
UNDERSTATED = "understated-noise"

#: The noise of both channels is estimated again until it changes by less than this share, or so many times.
_SETTLED, _MOST_ROUNDS = 0.01, 30

#: Variances over the assumed one are not taken for smaller: data that are simulated may have no noise.
_LEAST_VARIANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of markers and forces.

    `marker_std` (n_markers,): standard deviation of every marker's own noise, per coordinate, mm; `common_std`:
    standard deviation of the motion common to all markers, per coordinate, mm; `memory`, `common_memory`: correlation,
    between frames that are `step_s` apart, of the markers' own noise and of the common motion; `step_s`: median time
    between frames, s; `force_std`: standard deviation of a force component, mN; `from_rest`: whether there were enough
    rest frames for an estimate; `evidence`, `force_evidence`: for a larger noise than stated, nats.
    """

    marker_std: FloatArray
    common_std: float
    memory: float
    common_memory: float
    step_s: float
    force_std: float
    from_rest: bool
    evidence: float = 0.0
    force_evidence: float = 0.0

    def whitened(self, flat: FloatArray, layout: SignalLayout) -> FloatArray:
        """Return residuals or changes of predictions (..., size), mm and mN, whitened by the noise: a linear map.

        The result is dimensionless; entries that were not measured become 0.
        """
        white = np.zeros_like(flat)
        for part in layout.parts:
            measured = part.markers(layout.measured)
            part.markers(white)[:] = self._markers(part.markers(flat), np.isfinite(measured), part)
            known = np.isfinite(part.forces(layout.measured))
            part.forces(white)[:] = np.where(known, part.forces(flat), 0.0) / self.force_std
        return white

    def draw(self, layout: SignalLayout, generator: np.random.Generator) -> FloatArray:
        """Return one draw of the whitened noise, shape (size,); 0 where nothing was measured."""
        return np.where(layout.seen, generator.standard_normal(layout.size), 0.0)

    def _markers(self, moved: FloatArray, seen: BoolArray, part: CasePart) -> FloatArray:
        moved = np.where(seen, moved, 0.0) / self.marker_std[:, None]
        # In units of the markers' own noise the common motion lies along one direction.
        shared = np.where(seen, 1.0 / self.marker_std[:, None], 0.0)
        length = np.maximum(np.linalg.norm(shared, axis=1, keepdims=True), 1e-300)
        along = shared / length
        common = (moved * along).sum(axis=-2, keepdims=True)
        step = np.diff(part.times, prepend=np.nan)
        own = self._faded(moved - along * common, self.memory, step, seen)
        common = common / np.sqrt(1.0 + (length * self.common_std) ** 2)
        together = self._faded(common, self.common_memory, step, np.asarray(seen.any(axis=1, keepdims=True)))
        return np.where(seen, own + along * together, 0.0)

    def _faded(self, values: FloatArray, memory: float, step: FloatArray, seen: BoolArray) -> FloatArray:
        """Return the innovations of an autoregressive process (..., n_frames, k, 3), both of unit variance."""
        if memory == 0.0:
            return values
        share = memory ** (np.nan_to_num(step[1:], nan=self.step_s) / self.step_s)[:, None, None]
        both = seen[1:] & seen[:-1]
        later = (values[..., 1:, :, :] - share * values[..., :-1, :, :]) / np.sqrt(1.0 - share**2)
        white = values.copy()
        white[..., 1:, :, :] = np.where(both, later, values[..., 1:, :, :])
        return np.asarray(white)


def estimate_noise(experiment: Experiment, layout: SignalLayout, settings: NoiseSettings = DEFAULT.noise) -> Noise:
    """Return the noise estimated from rest frames and holds, or the stated one where they do not contradict it.

    Where there are no frames of a rest case (one without load), the noise has the stated standard deviations and is
    white in time. Raises `NoiseError` if forces were measured and their standard deviation is not stated.
    """
    n_markers = len(experiment.marker_names)
    stated = np.full(n_markers, experiment.marker_std)
    force_std = experiment.force_std
    if force_std is None:
        if any(part.pads for part in layout.parts):
            message = "`[forces]` must state `std_mN` where forces were measured"
            raise NoiseError(message, where="forces")
        force_std = 1.0
    still = _still(experiment, layout, settings.least_hold)
    if sum(len(values) for values, _ in still) < settings.least_frames or n_markers < 2:
        return Noise(stated, 0.0, 0.0, 0.0, 1.0, force_std, False)
    axes = float(still[0][0].shape[-1])
    means = [values.mean(axis=1, keepdims=True) for values, _ in still]
    own = [values - mean for (values, _), mean in zip(still, means, strict=True)]
    shapes = [(len(values), fitted) for values, fitted in still]
    memory = _memory(own, shapes, settings.correlated)
    # Subtracting the mean of correlated frames removes a part of the noise.
    freedom = axes * (1.0 - 1.0 / n_markers) * _expected(memory, shapes)[0]
    # Median absolute deviations: a single jump does not make a marker noisy. Their efficiency is 0.37.
    spread = 1.4826 * np.median(np.abs(np.concatenate(own)), axis=(0, 2))
    whole = axes * sum(frames for frames, _ in shapes)
    variance, freedom = spread**2 * whole / freedom, 0.37 * freedom
    # The median over markers, since one may be noisier; it lies below the mean of equally noisy ones.
    pooled, together = float(np.median(variance)) * freedom / float(chi2.median(freedom)), freedom * n_markers
    marker_std = _believed(
        stated, np.full(n_markers, np.sqrt(pooled)), pooled * together / stated**2, together, settings
    )
    # A marker that is noisier than the others.
    marker_std = _believed(marker_std, np.sqrt(variance), variance * freedom / marker_std**2, freedom, settings)
    common_freedom = axes * _expected(memory, shapes)[0]
    common = float(sum((mean**2).sum() for mean in means)) / common_freedom
    expected = float((marker_std**2).mean() / n_markers)
    alike = chi2.sf(common_freedom * common / expected, common_freedom) < settings.level
    common_std = float(np.sqrt(max(common - expected, 0.0))) if alike else 0.0
    step = float(np.median(np.concatenate([np.diff(part.times) for part in layout.parts])))
    common_memory = _memory(means, shapes, settings.correlated) if alike else memory
    evidence = scale_evidence(pooled * together / experiment.marker_std**2, together, settings)
    return Noise(marker_std, common_std, memory, common_memory, step, force_std, True, evidence)


def scale_evidence(power: float, freedom: float, settings: NoiseSettings) -> float:
    """Return the log Bayes factor, nats, of larger noise; `power`: sum of squares over the stated variance."""
    reach = 6.0 * settings.spread
    stated, larger = np.linspace(-reach, reach, 2001), np.linspace(0.0, np.log(settings.largest_factor), 20001)

    def log_mean(logs: FloatArray, prior: FloatArray) -> float:
        values = -0.5 * power * np.exp(-2.0 * logs) - freedom * logs
        top = float(values.max())
        return top + float(np.log(np.average(np.exp(values - top), weights=prior)))

    given = log_mean(stated, np.exp(-0.5 * (stated / settings.spread) ** 2))
    return log_mean(larger, np.ones_like(larger)) - given


def _still(experiment: Experiment, layout: SignalLayout, least_hold: int) -> list[tuple[FloatArray, int]]:
    """Return runs (n_frames, n_markers, n_axes), mm, without change of load, with the number of fitted parameters."""
    found = []
    along = np.any([np.isfinite(part.markers(layout.measured)).any(axis=(0, 1)) for part in layout.parts], axis=0)
    for part in layout.parts:
        case, frames = experiment.cases[part.name], part.markers(layout.measured)[..., along]
        whole = np.asarray(np.isfinite(frames).all(axis=(1, 2)))
        if part.name == experiment.rest_case:
            if whole.sum() > 1:
                found.append((frames[whole] - frames[whole].mean(axis=0), 1))
            continue
        given = [*case.displacements.values(), *case.applied_forces.values()]
        if experiment.rest_case is None or not given:
            continue
        acts = np.concatenate(given, axis=1)
        same = np.concatenate([[False], (acts[1:] == acts[:-1]).all(axis=1) & acts[1:].any(axis=1)])
        begins = np.flatnonzero(~same)
        for begin, end in zip(begins, [*begins[1:], len(same)], strict=True):
            # The first frame of a hold may still show fast relaxation.
            rows = np.arange(begin + 1, end)
            rows = rows[whole[rows]]
            if len(rows) >= least_hold:
                # A line in time removes slow changes such as relaxation.
                line = np.stack([np.ones(len(rows)), part.times[rows] - part.times[rows].mean()], axis=1)
                values = frames[rows].reshape(len(rows), -1)
                values = values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
                found.append((values.reshape(len(rows), *frames.shape[1:]), 2))
    return found


def _believed(
    stated: FloatArray, found: FloatArray, statistic: FloatArray, freedom: float, settings: NoiseSettings
) -> FloatArray:
    """Return standard deviations (k,), mm: stated ones where a chi-square test agrees, those found elsewhere."""
    tail = 2.0 * np.minimum(chi2.sf(statistic, freedom), chi2.cdf(statistic, freedom))
    return np.where(tail < settings.level, np.maximum(found, settings.least_share * stated), stated)


def _memory(runs: list[FloatArray], shapes: list[tuple[int, int]], above: float) -> float:
    """Return the correlation of noise from one frame to the next, over runs (n_frames, k, n_axes) in mm; 0 if none."""
    power = float(sum((values**2).sum() for values in runs))
    if power == 0.0:
        return 0.0
    found = float(sum((values[1:] * values[:-1]).sum() for values in runs)) / power
    tried = np.linspace(0.0, 0.95, 96)
    expected = np.array([pairs / squares for squares, pairs in (_expected(memory, shapes) for memory in tried)])
    error = 1.0 / np.sqrt(sum(values[1:].size for values in runs))
    return float(tried[np.argmin(np.abs(expected - found))]) if found > expected[0] + above * error else 0.0


def _expected(memory: float, shapes: list[tuple[int, int]]) -> tuple[float, float]:
    """Return the expected sums of squares and of products of neighbouring frames, for a coordinate of unit noise."""
    power = pairs = 0.0
    for n_frames, fitted in shapes:
        frames = np.arange(n_frames)
        line = np.linalg.qr(np.stack([np.ones(n_frames), frames - frames.mean()], axis=1)[:, :fitted])[0]
        projector = np.eye(n_frames) - line @ line.T
        covariance = projector @ memory ** np.abs(frames[:, None] - frames).astype(np.float64) @ projector
        power += float(np.trace(covariance))
        pairs += float(np.trace(covariance, offset=1))
    return power, pairs


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


def larger_noise(
    noise: Noise,
    experiment: Experiment,
    layout: SignalLayout,
    left: FloatArray,
    rows: FloatArray,
    settings: NoiseSettings,
) -> Noise | None:
    """Return the noise that explains what a fit leaves where it is larger than the assumed `noise`; None where not.

    `left` (size,): residual of the best fit; `rows` (k, size): all that may change the data beside noise; both whitened
    by the assumed noise.
    """
    of_markers, of_forces = _channels(rows, left, layout, settings)
    # Rest frames may already have shown a part of what is not stated.
    before = float(np.median(noise.marker_std)) / experiment.marker_std
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
