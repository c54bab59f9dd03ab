"""The test statistics by which a registration with a trained model is compared with the calibration set."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.calibration import Calibration
from tissuereg.registration.learned.mixture import HOPELESS, Component, Evidence, log_noise_odds
from tissuereg.registration.learned.smoother import Screening
from tissuereg.registration.trust import NOISE_FACTORS

#: Markers whose fit to the others is found anew without a simulation: those that fit worst at first.
_CANDIDATES = 3

#: Least chance of which the logarithm is taken.
_LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class Statistics:
    """Test statistics of one registration with a trained model, dimensionless.

    `row` (5,): as `tissuereg.registration.learned.calibration_set.STATISTICS`; `marker_rows` (n_markers,): the
    statistic of each marker: the second of `row` is the largest of them; `marker_misfits` (n_markers,): squared misfit
    of each marker to the prediction from the others, in its own standard deviations.
    """

    row: FloatArray
    marker_rows: FloatArray
    marker_misfits: FloatArray


def statistics_of(
    calibration: Calibration,
    prior: list[Component],
    screening: Screening,
    observed: FloatArray,
    noise: FloatArray,
    n_own: int,
) -> Statistics:
    """Return the test statistics of a registration.

    `calibration`: knows how far a code lies from the training set; `prior`: mixture, of which `screening` has the
    evidence, that of a simulated event with every marker compared; `observed` (n_obs,): measured displacements, mm;
    `noise` (n_obs, n_obs): covariance of the tracker's noise, mm^2; `n_own`: number of components of the simulated
    event, which come first; the others are those of an event that was not simulated. Cost: a Cholesky factor of size
    n_obs for every pair of component and scale, and for each of `NOISE_FACTORS`, and without a simulation an inverse
    for every pair.
    """
    from scipy.special import gammaincc

    found, simulated = screening.found, screening.simulated
    # About a simulation: a wrong marker pulls the answer to where the decoder's slopes are others.
    by_marker = (
        screening.first if simulated else Evidence.of(prior, screening.linear, observed, noise, compared="every")
    )
    misfits, chances = by_marker.chances()
    logs = -np.log(np.maximum(chances, _LEAST))
    # Fisher's method, as if predictions of different markers were independent: rehearsals say what they are.
    misfit = -np.log(max(float(gammaincc(len(logs), logs.sum())), _LEAST)) if len(logs) else 0.0
    unrelated = 0.0
    if not simulated:
        for number in np.argsort(-logs, kind="stable")[:_CANDIDATES]:
            logs[number] = -np.log(max(screening.chance_of(int(number), prior, observed, noise), _LEAST))
    markers = logs - np.log(max(len(logs), 1))
    if simulated:
        own, others = (np.logaddexp.reduce(part) for part in np.split(found.of_components, [n_own]))
        # A screening leaves out what is less probable than that.
        unrelated = min(max(float(others - own), 0.0), -np.log(HOPELESS))
    # A ratio of evidences above x has a chance of at most 1 / x (A. A. Markov), for each factor.
    larger = max(log_noise_odds(by_marker, noise) - np.log(len(NOISE_FACTORS)), 0.0)
    far = calibration.distance(found.mean_latents)
    return Statistics(np.array([misfit, markers.max(initial=-np.inf), far, unrelated, larger]), markers, misfits)
