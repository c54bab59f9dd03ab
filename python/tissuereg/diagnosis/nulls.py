"""Null draws: residuals of effect-free data of the same rig, the thresholds that follow, and the test of a residual.

A draw is the sum of measurement noise of uncertain size, nuisance parameters from their priors, and the discretisation
error of a mesh that is neither the user's nor the correcting one; noise alone would give much lower thresholds.

The misfit test has a battery of statistics, each a sum of squares (over everything, a case, a pad's force, a smooth
subspace) or a largest one (over markers, over frames). Single cases, markers and frames detect large local residuals;
smooth subspaces, which hold little of the noise, the smooth residuals in phase with the load that a wrong cause leaves.
The logarithm of each is standardised over null draws, and the p-value is that of the largest of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.evidence import Null, tail_probability
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, NullSettings
from tissuereg.diagnosis.signals import (
    SignalLayout,
    force_columns,
    histories,
    marker_columns,
    orthonormal,
    smooth_patterns,
)


@dataclass(frozen=True, eq=False)
class Nulls:
    """Residuals (n, size) drawn for data without any effect, whitened by noise and nuisances, and thresholds of causes.

    The thresholds, nats, by id, are higher for causes that resemble a discretisation error.
    """

    residuals: FloatArray
    thresholds: Mapping[str, float]


def draw_nulls(
    screen: Screen,
    null: Null,
    noise: Noise,
    layout: SignalLayout,
    mesh_errors: Sequence[FloatArray],
    seed: int,
    settings: DiagnoseSettings = DEFAULT,
) -> Nulls:
    """Return residuals drawn for data without any effect, and the thresholds that follow.

    `mesh_errors`: for each further fine mesh the prediction (size,) on it minus that on the correcting one, mm and mN;
    `seed`: seed of the draws. There are `draws` residuals.
    """
    generator, rules = np.random.default_rng([seed, 5]), settings.nulls
    alone = rules.noise_alone
    white = [] if alone else [noise.whitened(error, layout) for error in mesh_errors]
    nuisances = null.nuisances[: 0 if alone else None]
    draws = np.empty((rules.draws, layout.size))
    for i in range(rules.draws):
        drawn = noise.draw(layout, generator) * (1.0 + rules.noise_spread * generator.standard_normal())
        sizes = 1.0 + rules.marker_spread * generator.standard_normal(len(layout.marker_names))
        for part in layout.parts:
            part.markers(drawn)[:] *= sizes[:, None]
        drawn += generator.standard_normal(len(nuisances)) @ nuisances
        if white:
            size = generator.choice([-1.0, 1.0]) * generator.uniform(1.0 / rules.mesh_spread, rules.mesh_spread)
            drawn += settings.nuisances.mesh_share * size * white[i % len(white)]
        draws[i] = drawn
    residuals = null.reduced(draws)
    found = screen.many(residuals)
    found.pop(UNKNOWN)
    given = {} if rules.required is None else dict.fromkeys(found, rules.required)
    return Nulls(residuals, given or _thresholds(found, rules))


def _thresholds(found: Mapping[str, FloatArray], settings: NullSettings = DEFAULT.nulls) -> dict[str, float]:
    """Return a threshold for every cause, nats, such that any cause passes its own in at most `level` of the draws."""
    values = np.array(list(found.values()))
    # A quantile of its own evidence, of the same order for all causes.
    # The last share is Bonferroni's bound, which holds however the causes are correlated.
    for share in settings.level * np.geomspace(1.0, 1.0 / len(values), settings.shares):
        least = np.maximum(np.quantile(values, 1.0 - share, axis=1), settings.least_threshold)
        if (values > least[:, None]).any(axis=0).mean() <= settings.level:
            break
    return dict(zip(found, least.tolist(), strict=True))


@dataclass(frozen=True)
class Misfit:
    """Result of the misfit test.

    `p`: probability that data without any effect misfit as much; `explained`: share of the believed model's misfit
    (statistic minus its mean over draws of such data) that the judged model removes: in the sum of all squares or,
    where that is smaller, in the statistic that is largest for the judged model.
    """

    p: float
    explained: float


class Battery:
    """The statistics of the misfit test: sums of squares of residuals, or the largest of several such sums.

    `subspaces`: orthonormal rows (k, size) that span each subspace of smooth changes (`smooth_subspaces`).
    """

    def __init__(self, layout: SignalLayout, subspaces: Sequence[FloatArray]) -> None:
        self.layout = layout
        self.subspaces = subspaces

    def judge(self, before: FloatArray, after: FloatArray, nulls: FloatArray) -> Misfit:
        """Return the misfit test of a model's residual.

        `before`, `after` (size,): residuals of the believed model and of the model that is judged; `nulls` (n, size):
        those of null draws; all whitened by noise and nuisances (`Null.reduced`). The p-value is that of the largest
        standardised statistic among those of the null draws (`tail_probability`).
        """
        sums, drawn = self.sums(np.stack([before, after])), self.sums(nulls)
        logs = np.log(drawn)
        centre, spread = logs.mean(axis=0), np.maximum(logs.std(axis=0), 1e-9)
        excess = (np.log(sums[1]) - centre) / spread
        worst = int(excess.argmax())
        p = tail_probability(float(excess[worst]), ((logs - centre) / spread).max(axis=1))
        # Of no misfit at all nothing is left to be explained; where one is largest, a model has added it.
        shares = [_removed(sums[:, at], drawn[:, at].mean(), of_none) for at, of_none in ((0, 1.0), (worst, 0.0))]
        return Misfit(p, min(shares))

    def sums(self, residuals: FloatArray) -> FloatArray:
        """Return all statistics (n, n_statistics), positive, of residuals (n, size), first the sum of all squares."""
        layout, rows = self.layout, [(residuals**2).sum(axis=1)]
        per_marker = np.zeros((len(residuals), len(layout.marker_names)))
        per_frame = []
        for part in layout.parts:
            markers = part.markers(residuals) ** 2
            rows.append(markers.sum(axis=(1, 2, 3)))
            per_marker += markers.sum(axis=(1, 3))
            per_frame.append(markers.sum(axis=(2, 3)))
            for i in range(len(part.pads)):
                forces = part.forces(residuals)[:, :, i] ** 2
                rows.append(forces.sum(axis=(1, 2)))
                per_frame.append(forces.sum(axis=2))
        rows.append(per_marker.max(axis=1))
        rows.append(np.concatenate(per_frame, axis=1).max(axis=1))
        rows += [((residuals @ basis.T) ** 2).sum(axis=1) for basis in self.subspaces]
        return np.asarray(np.maximum(np.stack(rows, axis=1), 1e-12))


def smooth_subspaces(
    layout: SignalLayout, base: FloatArray, extent: float, noise: Noise, settings: DiagnoseSettings = DEFAULT
) -> list[FloatArray]:
    """Return the subspaces of smooth changes: per case, one for each time history and one for all of them together.

    `base` (size,): prediction of the believed model, mm and mN; `extent`: extent of the body, mm. Each subspace is
    given by orthonormal rows (k, size) over whitened data.
    """
    patterns = smooth_patterns(layout.reference, extent, settings.nuisances)[: settings.nulls.smooth]
    found = []
    for part in layout.parts:
        of_case = []
        for history in histories(part, base, settings.evidence.fading):
            markers = marker_columns(layout, part, history, patterns).reshape(-1, layout.size)
            forces = [force_columns(layout, part, pad, history) for pad in range(len(part.pads))]
            of_case.append(noise.whitened(np.concatenate([markers, *forces]), layout))
        found += [orthonormal(columns) for columns in (*of_case, np.concatenate(of_case))]
    return [basis for basis in found if len(basis)]


def _removed(sums: FloatArray, expected: float, of_none: float) -> float:
    """Return the share of a statistic's excess over its `expected` value that a model removes, `of_none` of none."""
    before, after = sums.tolist()
    return float((before - after) / (before - expected)) if before > expected else of_none
