r"""Input of the sampler: the observations as they are, or, if they are many, a projection of them.

The cost of sampling grows with the square of the number of observations. Hundreds of points of one surface hold little
independent information: with responses J, noise C and prior variances D of the columns, the eigenvectors of

    G = C^{-1/2} J D J' C^{-1/2}

with large eigenvalues span nearly everything that any cause can do to the observations. D is the variance of each patch
if it is pushed, summed over patches, so that in a direction with eigenvalue s no single contact has a signal of more
than sqrt(s) standard deviations. The projection has the identity as noise covariance. The eigenvectors of one pass are
reused in later passes with the same points, so that only the sensitivities of the projection are needed there.
"""

from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.registration.contacts.columns import Columns, contact_sizes
from tissuereg.registration.contacts.measured import Observations
from tissuereg.registration.contacts.settings import MATCHING, ContactSettings


@dataclass(frozen=True, eq=False)
class LinearObservations:
    """Observations as a linear function of the coefficients of the causes, about one body.

    They are n_obs = n_kept measured displacements in mm or, if these are many, n_kept combinations of them over their
    standard deviations, without unit. `responses` (n_kept, n_columns): change of each by a unit coefficient of each
    cause; `innovation` (n_kept,): measured minus predicted at zero coefficients; `variances` (n_kept,): variances of
    their independent noise; `groups`: for each marker the observations that may be wrong together; empty if they are
    combinations; `rows`: nodes int64 (k,) of each observation, and the weights (k, 3) of their displacement;
    `dropped_signal`: largest variance due to the causes, over that of the noise, of a combination that was left out.
    """

    responses: FloatArray
    innovation: FloatArray
    variances: FloatArray
    groups: list[list[int]]
    rows: list[tuple[IntArray, FloatArray]]
    dropped_signal: float = 0.0

    def only(self, kept: BoolArray) -> "LinearObservations":
        """Return those observations that are kept, bool (n_obs,), without groups."""
        rows = [row for row, one in zip(self.rows, kept, strict=True) if one]
        return replace(
            self,
            responses=self.responses[kept],
            innovation=self.innovation[kept],
            variances=self.variances[kept],
            groups=[],
            rows=rows,
        )


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal combinations of observations, over their standard deviations, that span the effects of all causes.

    `vectors` (n_kept, n_obs): one combination per row; `dropped_signal`: largest variance due to the causes, over that
    of the noise, of a combination that was dropped.
    """

    vectors: FloatArray
    dropped_signal: float

    @classmethod
    def of(cls, reading: Observations, responses: FloatArray, variances: FloatArray, most: int) -> "Basis":
        """Return the combinations of observations in which the causes have an effect.

        `reading`: observations at a body; `responses` (n_obs, n_columns): their displacement by a unit coefficient of
        every cause, mm; `variances` (n_columns,): prior variances of the coefficients; `most`: largest number of
        combinations.
        """
        white = responses / reading.std[:, None]
        signals, vectors = np.linalg.eigh((white * variances) @ white.T)
        n_kept = min(most, max(1, int(np.sum(signals > MATCHING.least_signal))))
        dropped = float(signals[-n_kept - 1]) if n_kept < len(signals) else 0.0
        return cls(np.ascontiguousarray(vectors[:, ::-1][:, :n_kept].T), max(dropped, 0.0))

    def rows(self, reading: Observations) -> list[tuple[IntArray, FloatArray]]:
        """Return nodes int64 (k,) and weights (k, 3), 1/mm, of the nodal displacement in every projected observation.

        `reading`: the observations before projection.
        """
        nodes, root = self.nodes(reading), self.vectors / reading.std
        weights = np.zeros((len(reading.rows), len(nodes), 3))
        for row, (own, given) in enumerate(reading.rows):
            np.add.at(weights[row], np.searchsorted(nodes, own), given)
        joined = np.tensordot(root, weights, 1)
        return [(nodes, one) for one in joined]

    @staticmethod
    def nodes(reading: Observations) -> IntArray:
        """Return the numbers of all nodes on which the observations of `reading` depend, int64 (k,), sorted."""
        return np.unique(np.concatenate([own for own, _ in reading.rows]))


def plain(reading: Observations, responses: FloatArray, coefficients: FloatArray) -> LinearObservations:
    """Return observations as they are, as a linear function of the coefficients of the causes.

    `reading`: observations at a body, mm; `responses` (n_obs, n_columns): their displacement by a unit coefficient of
    every cause, mm; `coefficients` (n_columns,): those of the body.
    """
    return LinearObservations(
        responses, reading.residual + responses @ coefficients, reading.std**2, reading.groups, reading.rows
    )


def projected(
    reading: Observations, basis: Basis, responses: FloatArray, coefficients: FloatArray
) -> LinearObservations:
    """Return observations projected onto a basis, as a linear function of the coefficients of the causes.

    `reading`: observations at a body, mm; `basis`: n_kept combinations of them; `responses` (n_kept, n_columns): change
    of each combination by a unit coefficient of every cause, dimensionless; `coefficients` (n_columns,): those of the
    body.
    """
    root = basis.vectors / reading.std
    innovation = root @ reading.residual + responses @ coefficients
    return LinearObservations(responses, innovation, np.ones(len(root)), [], basis.rows(reading), basis.dropped_signal)


def moving_variances(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the prior variance (n_columns,) of the coefficient of each cause, given that this cause acts.

    It is the mean over the candidate sizes of the cause, weighted by their prior, in mm^2 (dimensionless for the error
    of a believed load).
    """
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
