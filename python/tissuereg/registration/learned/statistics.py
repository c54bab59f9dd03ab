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
    """Test statistics of one registration with a calibrated model, dimensionless.

    `row` (4,) holds minus the logarithm of the p-value of the innovation, the largest of `marker_rows`, the Mahalanobis
    distance of the latents from the training set, and the log-odds that the simulation is of another event (at least
    0). `marker_rows` (n_markers,) is minus the logarithm of the number of markers times the p-value of each marker
    given the others. `marker_misfits` (n_markers,) is the squared Mahalanobis distance of each marker from its
    prediction by the others.
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

    `calibration` holds the distribution of the training set's latents; `found` is the posterior; `n_own` is the number
    of prior components of the registered event, which come first, before those of an event unrelated to the simulation.
    Cost: an inverse of a factor of size n_obs for every pair of component and scale that was kept.
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
