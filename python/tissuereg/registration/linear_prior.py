r"""Gaussian posterior of a displacement field observed linearly at markers, in closed form, without a solve.

A field ``u ~ N(0, s P)`` is known by the prior covariance of the displacements of the markers, ``W = C P C'`` with the
observation matrix C, and by that of the nodes with them, ``U = P C'``. Given displacements d with independent noise of
diagonal covariance R, the most probable field is

    u = s U (s W + R)^-1 d,

of which everything but d is made beforehand. The scale s is the one of the highest evidence,

    -2 log p(d | s) = sum_k log(1 + s l_k) + y_k^2 / (1 + s l_k) + constant,

with l_k the eigenvalues of ``R^-1/2 W R^-1/2`` and y the whitened displacements in its eigenvectors (type-II maximum
likelihood, D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 415-447, 1992).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arguments import real
from tissuereg._base.arrays import FloatArray, IntArray, float_array

#: Signal over noise of the strongest direction, ``s l_max``, that are tried, as powers of ten; the best is refined by a
#: parabola.
_POWERS = np.linspace(-4.0, 16.0, 161)

#: Sets of seen markers whose eigenvectors are kept.
_KEPT = 64


@dataclass(frozen=True, eq=False)
class LinearAnswer:
    """The most probable displacement field given the markers, with the scale and the evidence of its prior.

    `displacement_mm` (n_nodes, 3): the field, mm; `scale`: factor s on the prior's covariance, dimensionless;
    `log_evidence`: logarithm of the density of the whitened displacements of the markers at this scale; it is
    comparable among priors.
    """

    displacement_mm: FloatArray
    scale: float
    log_evidence: float


@dataclass(frozen=True, eq=False)
class _Directions:
    """Eigenvectors of the prior covariance of the displacements of one set of markers, whitened by the noise.

    `rows` int64 (n_obs,): numbers of the measured coordinates, 3 m + i for axis i of marker m; `values` (n_obs,):
    eigenvalues, dimensionless; `vectors` (n_obs, n_obs): one eigenvector a column, each row divided by the standard
    deviation of the noise, 1/mm.
    """

    rows: IntArray
    values: FloatArray
    vectors: FloatArray

    @cached_property
    def _largest(self) -> float:
        return float(self.values.max(initial=0.0))

    @cached_property
    def _tried(self) -> tuple[FloatArray, FloatArray]:
        """Terms of the evidence at each trial scale s: ``sum_k log(1 + s l_k)``, and ``1 / (1 + s l_k)`` for each k.

        The l_k are the eigenvalues `values`; the shapes are (n_scales,) and (n_scales, n_obs).
        """
        grown = 1.0 + 10.0 ** _POWERS[:, None] * (self.values / self._largest)
        return np.log(grown).sum(axis=1), np.asarray(1.0 / grown)

    def best_scale(self, squares: FloatArray) -> float:
        """Return the factor on the prior covariance with the highest evidence; 0 if the prior has no variance.

        `squares` (n_obs,): squared coordinates of the whitened displacements in the eigenvectors, dimensionless.
        """
        if self._largest <= 0.0:
            return 0.0
        logs, shares = self._tried
        cost = logs + _product(shares, squares)
        at = int(np.argmin(cost))
        power = float(_POWERS[at])
        if 0 < at < len(_POWERS) - 1:
            before, here, after = (float(one) for one in cost[at - 1 : at + 2])
            bend = before - 2.0 * here + after
            power += 0.5 * float(_POWERS[1] - _POWERS[0]) * (before - after) / bend if bend > 0.0 else 0.0
        return float(10.0**power / self._largest)


class LinearPrior:
    """A Gaussian prior of the displacement of nodes, given by its covariances with the displacement of markers.

    `at_markers` (3 n_markers, 3 n_markers): covariance W of the markers' displacements at scale one, mm^2; `to_nodes`
    (n_nodes, 3, 3 n_markers): covariance U of the nodes' displacements with them, mm^2; `std_mm` (n_markers,): standard
    deviation of a measured coordinate, mm. Raises `ShapeError` if an array has another shape.
    """

    def __init__(self, at_markers: FloatArray, to_nodes: FloatArray, std_mm: FloatArray) -> None:
        std = float_array("std_mm", std_mm, (None,))
        n_rows = 3 * len(std)
        given = float_array("at_markers", at_markers, (n_rows, n_rows))
        self._at_markers = 0.5 * (given + given.T)
        nodes = float_array("to_nodes", to_nodes, (None, 3, n_rows))
        self._n_nodes = len(nodes)
        self._to_nodes = nodes.reshape(-1, n_rows)
        self._std = np.repeat(std, 3)
        self._known: dict[bytes, _Directions] = {}

    def plus(self, fields: FloatArray, seen: FloatArray, share: float) -> "LinearPrior":
        """Return the prior of the sum of a field of this prior and independent random multiples of further fields.

        The multiples are Gaussian with one common variance. `fields` (n_fields, n_nodes, 3): displacement of the nodes
        in each further field, in a common unit; `seen` (n_fields, 3 n_markers): displacement of the markers in them, in
        the same unit; `share`: variance at the markers that the further fields add, over that of this prior, both as
        means over the markers.
        """
        variance = share * np.trace(self._at_markers) / float(np.sum(seen * seen))
        to_nodes = self._to_nodes + variance * fields.reshape(len(fields), -1).T @ seen
        both = self._at_markers + variance * seen.T @ seen
        return LinearPrior(both, to_nodes.reshape(self._n_nodes, 3, -1), self._std[::3])

    def scaled(
        self,
        displacement_mm: FloatArray,
        seen: IntArray,
        scale: float | None = None,
        std_mm: FloatArray | None = None,
    ) -> tuple[float, float, FloatArray]:
        """Return the scale of the prior covariance, the log evidence, and the weights of the most probable field.

        The weights (3 n_markers,), in 1/mm, are factors on the columns of U, the covariance of the nodes with the
        markers. `displacement_mm` (n_seen, 3): measured displacements of the markers that were seen, mm; `seen` int64
        (n_seen,): numbers of these markers; `scale`: factor on the prior covariance, by default that of the highest
        evidence; `std_mm` (n_seen,): standard deviation of each coordinate at this moment, mm; by default that of the
        prior. Cost: two products with a matrix of (3 n_seen, 3 n_seen), and its eigenvalues where `std_mm` is given or
        the markers were never seen together before.
        """
        here = self._kept_directions(seen) if std_mm is None else self._directions(seen, np.repeat(std_mm, 3))
        observed = float_array("displacement_mm", displacement_mm, (len(seen), 3)).ravel()
        y = _product(here.vectors.T, observed)
        if scale is None:
            scale = here.best_scale(y * y)
        grown = 1.0 + real("scale", scale, least=0.0) * here.values
        weights = np.zeros(len(self._std))
        weights[here.rows] = _product(here.vectors, scale * y / grown)
        evidence = -0.5 * float(np.sum(np.log(grown) + y * y / grown + np.log(2.0 * np.pi)))
        return scale, evidence, weights

    def field(self, weights: FloatArray) -> FloatArray:
        """Return the field U w (n_nodes, 3), mm; U: covariance with the markers, w: `weights` (3 n_markers,), 1/mm."""
        return _product(self._to_nodes, weights).reshape(self._n_nodes, 3)

    def answer(self, displacement_mm: FloatArray, seen: IntArray, scale: float | None = None) -> LinearAnswer:
        """Return the most probable displacement field given measured displacements of markers.

        `displacement_mm` (n_seen, 3): measured displacements, mm; `seen` int64 (n_seen,): numbers of the markers;
        `scale`: factor on the prior's covariance, by default that of the highest evidence. Cost: that of `scaled`, and
        a product with the covariance U of the nodes with the markers.
        """
        scale, evidence, weights = self.scaled(displacement_mm, seen, scale)
        return LinearAnswer(self.field(weights), scale, evidence)

    def _kept_directions(self, seen: IntArray) -> _Directions:
        key = seen.tobytes()
        if key not in self._known:
            while len(self._known) >= _KEPT:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._directions(seen, self._std.reshape(-1, 3)[seen].ravel())
        return self._known[key]

    def _directions(self, seen: IntArray, std: FloatArray) -> _Directions:
        rows = (3 * seen[:, None] + np.arange(3)).ravel()
        values, vectors = np.linalg.eigh(self._at_markers[np.ix_(rows, rows)] / np.outer(std, std))
        return _Directions(rows, np.maximum(values, 0.0), vectors / std[:, None])


def most_probable(
    priors: "dict[str, LinearPrior]", displacement_mm: FloatArray, seen: IntArray, std_mm: FloatArray | None = None
) -> tuple[str, LinearAnswer]:
    """Return the name of the prior with the highest evidence, and the most probable displacement field under it.

    `priors`: the priors to compare, by name; `displacement_mm` (n_seen, 3): measured displacements of markers, mm;
    `seen` int64 (n_seen,): numbers of these markers; `std_mm` (n_seen,): standard deviations of their coordinates, mm,
    by default those of the priors.
    """
    found = {name: prior.scaled(displacement_mm, seen, std_mm=std_mm) for name, prior in priors.items()}
    best = max(found, key=lambda name: found[name][1])
    scale, evidence, weights = found[best]
    return best, LinearAnswer(priors[best].field(weights), scale, evidence)


def _product(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return ``matrix @ vector``, (m,), by one thread: on busy cores, waking another takes far longer."""
    return np.asarray(np.einsum("ij,j->i", matrix, vector))
