"""The noise of the measurement: how large, how alike between markers, how it fades in time; and its whitening.

A frame of markers is split into its mean (camera motion) and what is left (each marker's own noise). Both are
autoregressive of first order; forces are white. Whitened numbers are uncorrelated with unit variance.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.signals import CasePart, Layout
from tissuereg.errors import NoiseError
from tissuereg.experiment import Experiment

#: A stated standard deviation is kept unless the rest frames contradict it at this level.
LEVEL = 1e-3

#: No noise is believed to be less than this share of the stated one: frames may be simulated, without any.
LEAST_SHARE = 0.1

#: Frames below this number say nothing about noise; a hold must have so many to count.
LEAST_FRAMES, LEAST_HOLD = 6, 4


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of markers and forces.

    Attributes
    ----------
    marker_std : ndarray of float64, shape (n_markers,)
        Of every marker's own noise, mm.
    common_std : float
        Of the motion that all markers share, mm.
    memory, common_memory : float
        Correlation of both from one frame of the rest case to the next.
    step_s : float
        Time between those frames.
    force_std : float
        mN.
    from_rest : bool
        Whether rest frames told.
    """

    marker_std: FloatArray
    common_std: float
    memory: float
    common_memory: float
    step_s: float
    force_std: float
    from_rest: bool

    def whitened(self, flat: FloatArray, layout: Layout) -> FloatArray:
        """Return flat vectors whitened; entries that were not measured become zero.

        Parameters
        ----------
        flat : ndarray of float64, shape (..., size)
            Differences from what is expected, mm and mN.
        layout : Layout
            Their order.

        Returns
        -------
        ndarray of float64, shape (..., size)
            Dimensionless. The map is linear.
        """
        white = np.zeros_like(flat)
        for part in layout.parts:
            measured = part.markers(layout.measured)
            part.markers(white)[:] = self._markers(part.markers(flat), np.isfinite(measured), part)
            known = np.isfinite(part.forces(layout.measured))
            part.forces(white)[:] = np.where(known, part.forces(flat), 0.0) / self.force_std
        return white

    def draw(self, layout: Layout, generator: np.random.Generator) -> FloatArray:
        """Return one draw of the whitened noise, shape (size,)."""
        return np.where(layout.seen, generator.standard_normal(layout.size), 0.0)

    def _markers(self, moved: FloatArray, seen: BoolArray, part: CasePart) -> FloatArray:
        moved = np.where(seen, moved, 0.0) / self.marker_std[:, None]
        # What all markers share lies along one direction, in units of their own noise.
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
        """Return values (..., n_frames, k, 3) less what the frame before says of them, in units of what is left."""
        if memory == 0.0:
            return values
        share = memory ** (np.nan_to_num(step[1:], nan=self.step_s) / self.step_s)[:, None, None]
        both = seen[1:] & seen[:-1]
        later = (values[..., 1:, :, :] - share * values[..., :-1, :, :]) / np.sqrt(1.0 - share**2)
        white = values.copy()
        white[..., 1:, :, :] = np.where(both, later, values[..., 1:, :, :])
        return np.asarray(white)


def estimate_noise(experiment: Experiment, layout: Layout) -> Noise:
    """Return the noise that rest frames and holds show, or the stated one where they say nothing against it.

    Parameters
    ----------
    experiment : Experiment
        With the stated standard deviations, and perhaps a rest case.
    layout : Layout
        Its measured numbers.

    Returns
    -------
    Noise
        White where there are no rest frames.

    Raises
    ------
    NoiseError
        If forces were measured and their standard deviation is not stated.
    """
    n_markers = len(experiment.marker_names)
    stated = np.full(n_markers, experiment.marker_std)
    force_std = experiment.force_std
    if force_std is None:
        if any(part.pads for part in layout.parts):
            message = "`[forces]` must state `std_mN` where forces were measured"
            raise NoiseError(message, where="forces")
        force_std = 1.0
    white = Noise(stated, 0.0, 0.0, 0.0, 1.0, force_std, False)
    still = _still(experiment, layout)
    if sum(len(values) for values, _ in still) < LEAST_FRAMES or n_markers < 2:
        return white
    axes = float(still[0][0].shape[-1])
    means = [values.mean(axis=1, keepdims=True) for values, _ in still]
    own = [values - mean for (values, _), mean in zip(still, means, strict=True)]
    shapes = [(len(values), fitted) for values, fitted in still]
    memory = _memory(own, shapes)
    # In runs of frames that are alike, taking out a mean takes out a part of the noise.
    freedom = axes * (1.0 - 1.0 / n_markers) * _expected(memory, shapes)[0]
    # Median deviations: a marker that jumps once is not a noisy one. They are worth 0.37 of the values.
    spread = 1.4826 * np.median(np.abs(np.concatenate(own)), axis=(0, 2))
    whole = axes * sum(frames for frames, _ in shapes)
    variance, freedom = spread**2 * whole / freedom, 0.37 * freedom
    # The median marker, not the mean: one may be noisier than the others. It lies below the mean of equal ones.
    pooled, together = float(np.median(variance)) * freedom / float(chi2.median(freedom)), freedom * n_markers
    marker_std = _believed(stated, np.full(n_markers, np.sqrt(pooled)), pooled * together / stated**2, together)
    # A marker that is noisier than the others.
    marker_std = _believed(marker_std, np.sqrt(variance), variance * freedom / marker_std**2, freedom)
    common_freedom = axes * _expected(memory, shapes)[0]
    common = float(sum((mean**2).sum() for mean in means)) / common_freedom
    expected = float((marker_std**2).mean() / n_markers)
    alike = chi2.sf(common_freedom * common / expected, common_freedom) < LEVEL
    common_std = float(np.sqrt(max(common - expected, 0.0))) if alike else 0.0
    step = float(np.median(np.concatenate([np.diff(part.times) for part in layout.parts])))
    common_memory = _memory(means, shapes) if alike else memory
    return Noise(marker_std, common_std, memory, common_memory, step, force_std, True)


def _still(experiment: Experiment, layout: Layout) -> list[tuple[FloatArray, int]]:
    """Return runs of frames in which nothing acts anew: the rest case less its mean, holds less their straight lines.

    Each (n_frames, n_markers, n_axes), with the number of values fitted to every coordinate; axes that no marker was
    measured along are left out. A slow change in a hold goes with the line.
    """
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
            # The first frame of a hold is where fast memory still shows.
            rows = np.arange(begin + 1, end)
            rows = rows[whole[rows]]
            if len(rows) >= LEAST_HOLD:
                line = np.stack([np.ones(len(rows)), part.times[rows] - part.times[rows].mean()], axis=1)
                values = frames[rows].reshape(len(rows), -1)
                values = values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
                found.append((values.reshape(len(rows), *frames.shape[1:]), 2))
    return found


def _believed(stated: FloatArray, found: FloatArray, statistic: FloatArray, freedom: float) -> FloatArray:
    """Return the stated deviations where a chi-square statistic does not contradict them, the found ones elsewhere."""
    tail = 2.0 * np.minimum(chi2.sf(statistic, freedom), chi2.cdf(statistic, freedom))
    return np.where(tail < LEVEL, np.maximum(found, LEAST_SHARE * stated), stated)


def _memory(runs: list[FloatArray], shapes: list[tuple[int, int]]) -> float:
    """Return the correlation of values (n_frames, k, 3) from frame to frame, over all runs; 0 if there is none."""
    power = float(sum((values**2).sum() for values in runs))
    if power == 0.0:
        return 0.0
    found = float(sum((values[1:] * values[:-1]).sum() for values in runs)) / power
    tried = np.linspace(0.0, 0.95, 96)
    said = np.array([pairs / left for left, pairs in (_expected(memory, shapes) for memory in tried)])
    error = 1.0 / np.sqrt(sum(values[1:].size for values in runs))
    return float(tried[np.argmin(np.abs(said - found))]) if found > said[0] + 4.0 * error else 0.0


def _expected(memory: float, shapes: list[tuple[int, int]]) -> tuple[float, float]:
    """Return expected sums of squares and of products of neighbours: unit noise in runs, mean or line taken out."""
    power = pairs = 0.0
    for n_frames, fitted in shapes:
        frames = np.arange(n_frames)
        line = np.linalg.qr(np.stack([np.ones(n_frames), frames - frames.mean()], axis=1)[:, :fitted])[0]
        left = np.eye(n_frames) - line @ line.T
        covariance = left @ memory ** np.abs(frames[:, None] - frames).astype(np.float64) @ left
        power += float(np.trace(covariance))
        pairs += float(np.trace(covariance, offset=1))
    return power, pairs
