r"""What the sampler is given: observations as they are, or, where they are many, their projection.

The cost of sampling grows with the square of the number of observations. Hundreds of points of one surface say few
different things: with rows J, noise C and prior variances D of the columns, the eigenvectors of

    G = C^{-1/2} J D J' C^{-1/2}

with large eigenvalues hold nearly all that any cause can do to the observations. D is the variance that each patch has
once it is pushed, summed over patches, so that in a direction with the eigenvalue s no single contact has a signal of
more than sqrt(s) standard deviations. What is projected has the noise of the identity.
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.contacts.columns import Columns
from tissuereg.contacts.seen import MOST_PLAIN, Reading
from tissuereg.contacts.settings import ContactSettings

#: Directions with a smaller signal (squared, over the noise) are dropped.
LEAST_SIGNAL = 0.3

#: At most so many are kept.
MOST_KEPT = 90


@dataclass(frozen=True, eq=False)
class Posed:
    """Data of one linearisation.

    Attributes
    ----------
    responses : ndarray of float64, shape (n_kept, n_columns)
        How they follow the causes.
    innovation : ndarray of float64, shape (n_kept,)
        Measured minus predicted at zero coefficients.
    variances : ndarray of float64, shape (n_kept,)
        Of their independent noise.
    groups : list of list of int
        Observations that may be wrong together.
    root : ndarray of float64, shape (n_kept, n_obs), or None
        What projects observations; None where they are as they were.
    dropped_signal : float
        Largest signal that was dropped.
    """

    responses: FloatArray
    innovation: FloatArray
    variances: FloatArray
    groups: list[list[int]]
    root: FloatArray | None
    dropped_signal: float = 0.0

    def project(self, matrix: FloatArray) -> FloatArray:
        """Return a matrix (n_obs, m) of observations as the sampler has them, (n_kept, m)."""
        return matrix if self.root is None else np.asarray(self.root @ matrix)


def posed(
    reading: Reading, responses: FloatArray, coefficients: FloatArray, columns: Columns, settings: ContactSettings
) -> Posed:
    """Return the data of one linearisation, projected where they are many.

    Parameters
    ----------
    reading : Reading
        Observations at the present body.
    responses : ndarray of float64, shape (n_obs, n_columns)
        How they follow the causes there.
    coefficients : ndarray of float64, shape (n_columns,)
        Of the causes there.
    columns : Columns
        Causes.
    settings : ContactSettings
        Their prior.

    Returns
    -------
    Posed
        As given up to `MOST_PLAIN` observations, or where a group of observations has an indicator.
    """
    innovation = reading.left + responses @ coefficients
    if len(innovation) <= MOST_PLAIN or reading.groups:
        return Posed(responses, innovation, reading.std**2, reading.groups, None)
    white = responses / reading.std[:, None]
    signals, vectors = np.linalg.eigh((white * moving_variances(columns, settings)) @ white.T)
    n_kept = min(MOST_KEPT, max(1, int(np.sum(signals > LEAST_SIGNAL))))
    root = np.ascontiguousarray(vectors[:, ::-1][:, :n_kept].T / reading.std)
    dropped = float(signals[-n_kept - 1]) if n_kept < len(signals) else 0.0
    return Posed(root @ responses, root @ innovation, np.ones(n_kept), [], root, max(dropped, 0.0))


def moving_variances(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the variance (n_columns,) that each coefficient has once its cause acts."""
    patches = columns.body.patches
    sizes = np.array(settings.sizes_mm)
    weights = np.exp(-0.5 * (sizes / (settings.largest_share * patches.radii[:, None])) ** 2)
    variances = np.zeros(columns.n_columns)
    by_patch = (weights @ sizes**2) / weights.sum(axis=1)
    variances[: 3 * patches.n_patches] = np.repeat(by_patch, 3)
    for family in columns.families[1:]:
        prior = np.exp(family.log_prior - family.log_prior.max())
        variances[family.columns] = family.variance * float(prior @ family.factors) / float(prior.sum())
    return variances
