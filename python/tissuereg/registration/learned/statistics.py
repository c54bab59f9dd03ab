"""The test statistics by which a registration with a calibrated model is compared with the calibration set."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.calibration import Calibration
from tissuereg.registration.learned.mixture import MixturePosterior, left_out

#: Least chance of which the logarithm is taken.
_LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class Statistics:
    """Test statistics of one registration.

    `row` (4,): as `tissuereg.registration.learned.calibration_set.STATISTICS`; `marker_rows` (n_markers,): the
    statistic of each marker: the second of `row` is the largest of them; `marker_misfits` (n_markers,): squared misfit
    of each marker to the prediction from the others, in its own standard deviations.
    """

    row: FloatArray
    marker_rows: FloatArray
    marker_misfits: FloatArray


def statistics_of(
    calibration: Calibration,
    found: MixturePosterior,
    n_own: int,
) -> Statistics:
    """Return the test statistics of a registration.

    `calibration`: knows how far a code lies from the training set; `found`: the posterior; `n_own`: number of
    components of the simulated event, which come first; the others are those of an event that was not simulated. Cost:
    an inverse of a factor of size n_obs for every pair of component and scale that was kept.
    """
    misfits, chances = left_out(found)
    markers = -np.log(np.maximum(len(chances) * chances, _LEAST))
    unrelated = 0.0
    if n_own < len(found.log_evidence):
        own, others = (np.logaddexp.reduce(part) for part in np.split(found.log_evidence, [n_own]))
        unrelated = max(float(others - own), 0.0)
    misfit = -np.log(max(found.p_value, _LEAST))
    row = np.array([misfit, markers.max(initial=-np.inf), calibration.distance(found.mean_latents), unrelated])
    return Statistics(row, markers, misfits)
