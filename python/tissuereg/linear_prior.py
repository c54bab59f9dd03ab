r"""Displacement fields with a Gaussian prior, observed linearly at markers: the answer without a solve.

A field ``u ~ N(0, s P)`` is known by the covariance of what the markers see, ``W = C P C'``, and by that of the nodes
with it, ``U = P C'``. Given displacements d with noise R of independent coordinates,

    u = s U (s W + R)^-1 d,

of which everything but d is made beforehand. The scale s is the one of the highest evidence,

    -2 log p(d | s) = sum_k log(1 + s l_k) + y_k^2 / (1 + s l_k) + constant,

with l_k the eigenvalues of ``R^-1/2 W R^-1/2`` and y the whitened displacements in its eigenvectors (type-II maximum
likelihood, D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 415-447, 1992).
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._arguments import real
from tissuereg._arrays import FloatArray, IntArray, float_array

#: Signal over noise of the strongest direction, ``s l_max``, between which the scale is sought, as powers of ten, and
#: the number of scales tried; the best is refined by a parabola.
_LOWEST, _HIGHEST, _N_TRIED = -4.0, 16.0, 161

#: Sets of seen markers whose eigenvectors are kept.
_KEPT = 64


@dataclass(frozen=True, eq=False)
class LinearAnswer:
    """The most probable field given the markers.

    Attributes
    ----------
    displacement_mm : ndarray of float64, shape (n_nodes, 3)
        The field.
    scale : float
        Factor s on the prior's covariance.
    log_evidence : float
        Logarithm of the density of the whitened displacements at this scale; comparable among priors.
    """

    displacement_mm: FloatArray
    scale: float
    log_evidence: float


@dataclass(frozen=True, eq=False)
class _Directions:
    """Eigenvalues, and the eigenvectors (n_obs, n_obs) over the noise, of one set of seen markers."""

    rows: IntArray
    values: FloatArray
    vectors: FloatArray


class LinearPrior:
    """A Gaussian prior of displacement fields at markers.

    Parameters
    ----------
    at_markers : array_like of float, shape (3 n_markers, 3 n_markers)
        Covariance W of the markers' displacements at scale one, mm^2.
    to_nodes : array_like of float, shape (n_nodes, 3, 3 n_markers)
        Covariance U of the nodes' displacements with them, mm^2.
    std_mm : array_like of float, shape (n_markers,)
        Standard deviation of a measured coordinate.

    Raises
    ------
    ShapeError
        If an array has another shape.
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

    def scaled(
        self,
        displacement_mm: FloatArray,
        seen: IntArray,
        scale: float | None = None,
        std_mm: FloatArray | None = None,
    ) -> tuple[float, float, FloatArray]:
        """Return scale, log evidence, and the weights (3 n_markers,) of the most probable field on the columns of U.

        Parameters
        ----------
        displacement_mm : ndarray of float64, shape (n_seen, 3)
            Displacements of the markers that were seen.
        seen : ndarray of int64, shape (n_seen,)
            Which these are.
        scale : float, optional
            Scale to use; by default that of the highest evidence.
        std_mm : ndarray of float64, shape (n_seen,), optional
            Standard deviation of each coordinate at this moment; by default that of the prior.

        Returns
        -------
        tuple of (float, float, ndarray of float64)
            Cost: two products with a matrix of (3 n_seen, 3 n_seen), and its eigenvalues where `std_mm` is given or the
            markers were never seen together before.
        """
        here = self._kept_directions(seen) if std_mm is None else self._directions(seen, np.repeat(std_mm, 3))
        observed = float_array("displacement_mm", displacement_mm, (len(seen), 3)).ravel()
        y = observed @ here.vectors
        if scale is None:
            scale = _best_scale(here.values, y * y)
        grown = 1.0 + real("scale", scale, least=0.0) * here.values
        weights = np.zeros(len(self._std))
        weights[here.rows] = here.vectors @ (scale * y / grown)
        evidence = -0.5 * float(np.sum(np.log(grown) + y * y / grown + np.log(2.0 * np.pi)))
        return scale, evidence, weights

    def field(self, weights: FloatArray) -> FloatArray:
        """Return the field (n_nodes, 3) with these weights (3 n_markers,) on the columns of U, mm."""
        return np.asarray((self._to_nodes @ weights).reshape(self._n_nodes, 3))

    def answer(self, displacement_mm: FloatArray, seen: IntArray, scale: float | None = None) -> LinearAnswer:
        """Return the most probable field; arguments as in `scaled`. Cost: a product with U in addition."""
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
    """Return the prior of the highest evidence and its answer; arguments as in `LinearPrior.scaled`."""
    found = {name: prior.scaled(displacement_mm, seen, std_mm=std_mm) for name, prior in priors.items()}
    best = max(found, key=lambda name: found[name][1])
    scale, evidence, weights = found[best]
    return best, LinearAnswer(priors[best].field(weights), scale, evidence)


def _best_scale(values: FloatArray, squares: FloatArray) -> float:
    """Return the scale of the highest evidence for eigenvalues and squared coordinates; 0 if nothing can move."""
    largest = float(values.max(initial=0.0))
    if largest <= 0.0:
        return 0.0
    powers = np.linspace(_LOWEST, _HIGHEST, _N_TRIED)
    grown = 1.0 + 10.0 ** powers[:, None] * (values / largest)
    cost = (np.log(grown) + squares / grown).sum(axis=1)
    at = int(np.argmin(cost))
    power = powers[at]
    if 0 < at < len(powers) - 1:
        before, here, after = cost[at - 1 : at + 2]
        bend = before - 2.0 * here + after
        power += 0.5 * (powers[1] - powers[0]) * (before - after) / bend if bend > 0.0 else 0.0
    return float(10.0**power / largest)
