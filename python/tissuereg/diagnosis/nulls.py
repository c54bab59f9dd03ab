"""Null draws: residuals of effect-free data of the same rig, and the thresholds that follow from them.

A draw is the sum of measurement noise of uncertain size, nuisance parameters from their priors, and the discretisation
error of a mesh that is neither the user's nor the correcting one; noise alone would give much lower thresholds. The log
Bayes factors of all causes are computed for every draw, and each cause gets a quantile of its own as threshold, the
same for all and such that any cause passes in a share `level` of the draws.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, NullSettings
from tissuereg.diagnosis.signals import SignalLayout


@dataclass(frozen=True, eq=False)
class Nulls:
    """Residuals drawn for data without any effect, and the thresholds of causes that follow from them.

    `residuals` (n, size): whitened by noise and nuisances; `thresholds`: log Bayes factor that each cause must exceed,
    nats, by id. It is higher for causes that resemble a discretisation error.
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

    `screen`: all hypotheses; `null`: covariance of noise and nuisances; `noise`: measurement noise; `layout`: order of
    the data; `mesh_errors`: for each further fine mesh the prediction (size,) on it minus that on the correcting one,
    mm and mN; `seed`: seed of the draws. There are `draws` residuals.
    """
    generator = np.random.default_rng([seed, 5])
    alone = settings.nulls.noise_alone
    white = [] if alone else [noise.whitened(error, layout) for error in mesh_errors]
    nuisances = null.nuisances[: 0 if alone else None]
    draws = np.empty((settings.nulls.draws, layout.size))
    for i in range(settings.nulls.draws):
        drawn = noise.draw(layout, generator) * (1.0 + settings.nulls.noise_spread * generator.standard_normal())
        sizes = 1.0 + settings.nulls.marker_spread * generator.standard_normal(len(layout.marker_names))
        for part in layout.parts:
            part.markers(drawn)[:] *= sizes[:, None]
        drawn += generator.standard_normal(len(nuisances)) @ nuisances
        if white:
            size = generator.choice([-1.0, 1.0]) * generator.uniform(
                1.0 / settings.nulls.mesh_spread, settings.nulls.mesh_spread
            )
            drawn += settings.nuisances.mesh_share * size * white[i % len(white)]
        draws[i] = drawn
    residuals = null.reduced(draws)
    found = screen.many(residuals)
    found.pop(UNKNOWN)
    required = settings.nulls.required
    given = None if required is None else dict.fromkeys(found, required)
    return Nulls(residuals, given or _thresholds(found, settings.nulls))


def _thresholds(found: Mapping[str, FloatArray], settings: NullSettings = DEFAULT.nulls) -> dict[str, float]:
    """Return a threshold for every cause, in nats, so that any cause passes its own in at most `level` of the draws.

    `found`: log Bayes factors (n,) of every cause in n draws without any effect, by id. The threshold of a cause is a
    quantile of its own log Bayes factors, of the same order for all causes, and at least `least_threshold`.
    """
    values = np.array(list(found.values()))
    # The last share is Bonferroni's bound, which holds however the causes are correlated.
    for share in settings.level * np.geomspace(1.0, 1.0 / len(values), settings.shares):
        least = np.maximum(np.quantile(values, 1.0 - share, axis=1), settings.least_threshold)
        if (values > least[:, None]).any(axis=0).mean() <= settings.level:
            break
    return dict(zip(found, least.tolist(), strict=True))
