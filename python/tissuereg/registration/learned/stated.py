"""What a model that was never calibrated says of itself, in the form of a calibration.

One kind of event, the distribution of all training fields; the errors that the model states; and, where pairs of
simulation and truth came with the training data, one kind of change. Nothing was rehearsed: events may be larger or
smaller by factors of two, and test statistics are taken for the chances that they state.
"""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.calibration import Calibration, Change, FieldErrors, Rehearsal
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.model import Gaussian

#: Factors on standard deviations, and their probabilities: from one on, each doubling is about half as likely.
_SCALES, _WEIGHTS = np.array([0.5, 1.0, 2.0, 4.0, 8.0]), np.array([[0.25, 0.4, 0.2, 0.1, 0.05]])

#: Measured coordinates by whose number errors are too few to say how they are correlated: 15 markers.
_COORDINATES = 45


def stated(
    family: Gaussian,
    errors: FloatArray,
    mismatch: FloatArray | None = None,
    change_errors: FloatArray | None = None,
) -> Calibration:
    """Return the calibration that a model states.

    `family`: latents of all training fields; `errors` (n_fields, n_nodes, 3): truth minus reconstruction of fields not
    used in training, mm; `mismatch` (n_latent, n_latent): second moments of encoder(truth) - encoder(simulation) over
    the size of the simulation, 1/mm^2, None where there are no pairs; `change_errors` (n_pairs, n_nodes, 3): what the
    decoder misses of the difference of truth and simulation, over that size, in mm per mm.
    """
    kinds = Components(np.ones(1), family.mean[None], family.covariance[None])
    law = Rehearsal(_SCALES, _WEIGHTS)
    if mismatch is None or change_errors is None:
        return Calibration(kinds, _moments(errors), law)
    change = Change(np.zeros(1), mismatch[None], _moments(change_errors))
    return Calibration(kinds, _moments(errors), law, change, law)


def _moments(errors: FloatArray) -> FieldErrors:
    """Return the second moments of error fields (n_fields, n_nodes, 3), mm.

    With fewer fields than measured coordinates spurious correlations would let the markers tell the error. Those
    between places are shrunk by the weight of Ledoit and Wolf's target for a sample of this size, ``1 / (1 + n_obs /
    n_fields)``; variances are kept.
    """
    keep = len(errors) / (len(errors) + _COORDINATES)
    rest = np.sqrt((1.0 - keep) * (errors**2).sum(axis=0) / max(len(errors), 1))
    return FieldErrors(errors, keep / max(len(errors), 1) * np.eye(len(errors))[None], rest)
