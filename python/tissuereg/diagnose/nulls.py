"""Effect-free data of the same rig: what the evidence of causes, and the misfit, look like where nothing is wrong.

A draw has the noise of the measurement, nuisances from their priors, and the error of a mesh that is neither the user's
nor the one that corrects it: noise alone would set every threshold far too low.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.evidence import Null
from tissuereg.diagnose.noise import Noise
from tissuereg.diagnose.nuisances import MESH_SHARE
from tissuereg.diagnose.screen import UNKNOWN, Screen
from tissuereg.diagnose.signals import Layout

#: Draws, and the share of them in which any cause may pass its threshold.
DRAWS = 500
LEVEL = 0.02

#: Shares that are tried for one cause.
SHARES = 40

#: No threshold lies below this many nats.
LEAST_THRESHOLD = 6.0

#: The noise is not known exactly: deviations of its size as a whole, and marker by marker.
NOISE_SPREAD, MARKER_SPREAD = 0.03, 0.05

#: Errors of other meshes are drawn larger and smaller than what was found for them, by this factor at most.
MESH_SPREAD = 1.3


@dataclass(frozen=True, eq=False)
class Nulls:
    """Reduced residuals of effect-free data.

    Attributes
    ----------
    residuals : ndarray of float64, shape (n, size)
        Whitened and reduced.
    thresholds : mapping of str to float
        Log Bayes factor of every cause that any of them passes in `LEVEL` of the draws: what looks like an error of the
        mesh must pass more than what looks like none.
    """

    residuals: FloatArray
    thresholds: Mapping[str, float]


def draw_nulls(
    screen: Screen, null: Null, noise: Noise, layout: Layout, mesh_errors: Sequence[FloatArray], seed: int
) -> Nulls:
    """Return effect-free residuals and the thresholds that follow.

    Parameters
    ----------
    screen : Screen
        All hypotheses.
    null : Null
        Nuisances.
    noise : Noise
        Of the measurement.
    layout : Layout
        Order of the data.
    mesh_errors : sequence of ndarray of float64, shape (size,)
        Other meshes less the correcting one, mm and mN.
    seed : int
        Of all chance.

    Returns
    -------
    Nulls
        `DRAWS` of them.
    """
    generator = np.random.default_rng([seed, 5])
    white = [noise.whitened(error, layout) for error in mesh_errors]
    draws = np.empty((DRAWS, layout.size))
    for i in range(DRAWS):
        drawn = noise.draw(layout, generator) * (1.0 + NOISE_SPREAD * generator.standard_normal())
        sizes = 1.0 + MARKER_SPREAD * generator.standard_normal(len(layout.marker_names))
        for part in layout.parts:
            part.markers(drawn)[:] *= sizes[:, None]
        drawn += generator.standard_normal(len(null.nuisances)) @ null.nuisances
        if white:
            size = generator.choice([-1.0, 1.0]) * generator.uniform(1.0 / MESH_SPREAD, MESH_SPREAD)
            drawn += MESH_SHARE * size * white[i % len(white)]
        draws[i] = drawn
    residuals = null.reduced(draws)
    found = screen.many(residuals)
    found.pop(UNKNOWN)
    return Nulls(residuals, _thresholds(found))


def _thresholds(found: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return what the log Bayes factors (n,) of every cause pass in one share of the draws, in `LEVEL` of them any."""
    values = np.array(list(found.values()))
    # At the last share all causes together pass in no more draws, whatever they have in common.
    for share in LEVEL * np.geomspace(1.0, 1.0 / len(values), SHARES):
        least = np.maximum(np.quantile(values, 1.0 - share, axis=1), LEAST_THRESHOLD)
        if (values > least[:, None]).any(axis=0).mean() <= LEVEL:
            break
    return dict(zip(found, least.tolist(), strict=True))
