r"""What the sampler is given: observations as they are, or, where they are many, their projection.

The cost of sampling grows with the square of the number of observations. Hundreds of points of one surface say few
different things: with rows J, noise C and prior variances D of the columns, the eigenvectors of

    G = C^{-1/2} J D J' C^{-1/2}

with large eigenvalues hold nearly all that any cause can do to the observations. D is the variance that each patch has
once it is pushed, summed over patches, so that in a direction with the eigenvalue s no single contact has a signal of
more than sqrt(s) standard deviations. What is projected has the noise of the identity. The eigenvectors of one pass
serve the next ones with the same points, whose sensitivities are then taken of the projection alone.
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.contacts.columns import Columns, contact_sizes
from tissuereg.contacts.seen import Reading
from tissuereg.contacts.settings import ContactSettings

#: Directions with a smaller signal (squared, over the noise) are dropped.
LEAST_SIGNAL = 0.3

#: At most so many are kept; in first passes, whose answer is rough, fewer.
MOST_KEPT, MOST_KEPT_COARSE = 80, 36


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
    rows : list of (ndarray of int64 (k,), ndarray of float64 (k, 3))
        Nodes and weights of each.
    dropped_signal : float
        Largest signal of a direction that was dropped.
    """

    responses: FloatArray
    innovation: FloatArray
    variances: FloatArray
    groups: list[list[int]]
    rows: list[tuple[IntArray, FloatArray]]
    dropped_signal: float = 0.0


@dataclass(frozen=True, eq=False)
class Basis:
    """Directions among whitened observations that hold what causes can do to them.

    Attributes
    ----------
    vectors : ndarray of float64, shape (n_kept, n_obs)
        Orthonormal rows.
    dropped_signal : float
        Largest signal, squared and over the noise, of a direction that was dropped.
    """

    vectors: FloatArray
    dropped_signal: float

    @classmethod
    def of(cls, reading: Reading, responses: FloatArray, variances: FloatArray, most: int) -> "Basis":
        """Return the basis of observations with given responses (n_obs, n_columns) to causes of given variances."""
        white = responses / reading.std[:, None]
        signals, vectors = np.linalg.eigh((white * variances) @ white.T)
        n_kept = min(most, max(1, int(np.sum(signals > LEAST_SIGNAL))))
        dropped = float(signals[-n_kept - 1]) if n_kept < len(signals) else 0.0
        return cls(np.ascontiguousarray(vectors[:, ::-1][:, :n_kept].T), max(dropped, 0.0))

    def rows(self, reading: Reading) -> list[tuple[IntArray, FloatArray]]:
        """Return nodes and weights of the projected observations."""
        nodes, root = self.nodes(reading), self.vectors / reading.std
        weights = np.zeros((len(reading.rows), len(nodes), 3))
        for row, (own, given) in enumerate(reading.rows):
            np.add.at(weights[row], np.searchsorted(nodes, own), given)
        joined = np.tensordot(root, weights, 1)
        return [(nodes, one) for one in joined]

    @staticmethod
    def nodes(reading: Reading) -> IntArray:
        """Return all nodes that observations follow, sorted."""
        return np.unique(np.concatenate([own for own, _ in reading.rows]))


def plain(reading: Reading, responses: FloatArray, coefficients: FloatArray) -> Posed:
    """Return observations as they are, with their responses (n_obs, n_columns) at the present coefficients."""
    return Posed(responses, reading.left + responses @ coefficients, reading.std**2, reading.groups, reading.rows)


def projected(reading: Reading, basis: Basis, responses: FloatArray, coefficients: FloatArray) -> Posed:
    """Return projected observations with their responses (n_kept, n_columns) at the present coefficients."""
    root = basis.vectors / reading.std
    innovation = root @ reading.left + responses @ coefficients
    return Posed(responses, innovation, np.ones(len(root)), [], basis.rows(reading), basis.dropped_signal)


def moving_variances(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the variance (n_columns,) that each coefficient has once its cause acts."""
    patches = columns.body.patches
    sizes = contact_sizes(columns, settings)
    weights = np.exp(-0.5 * (sizes / (settings.largest_share * patches.radii[:, None])) ** 2)
    variances = np.zeros(columns.n_columns)
    by_patch = (weights @ sizes**2) / weights.sum(axis=1)
    variances[: 3 * patches.n_patches] = np.repeat(by_patch, 3)
    for family in columns.families[1:]:
        prior = np.exp(family.log_prior - family.log_prior.max())
        variances[family.columns] = family.variance * float(prior @ family.factors) / float(prior.sum())
    return variances
