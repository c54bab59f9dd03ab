"""The uncertainty of a registered displacement field, compactly: everywhere in the body, and for points asked later."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg._base.shown import short_repr


@dataclass(frozen=True, eq=False)
class Deviations:
    """Fields whose outer products add up to the covariance of a displacement field.

    Attributes
    ----------
    modes : ndarray of float32, shape (n_modes, n_nodes, 3)
        Displacements of the nodes, mm: the field deviates by their sum, with independent standard normal factors.
    rest : ndarray of float32, shape (n_nodes, 3)
        Variance along each axis that the modes leave out, mm^2.
    doubt : ndarray of float32, shape (n_nodes,)
        By how much the variance that the markers leave exceeds what may be relied on, mm^2; interpolated, it is above
        zero where the markers say too little of a point.
    tail : float or None
        Degrees of freedom of the t law of a point, of a calibrated model; None for a Gaussian.
    """

    modes: FloatArray
    rest: FloatArray
    doubt: FloatArray
    tail: float | None = None

    __repr__ = short_repr

    @classmethod
    def of(
        cls,
        roots: FloatArray,
        doubt: FloatArray,
        tail: float | None = None,
        left_out: float = 0.01,
        besides: FloatArray | float = 0.0,
    ) -> "Deviations":
        """Return the uncertainty of which fields `roots` (n, n_nodes, 3), mm, are the roots, in as few modes as do.

        `left_out`: share of the summed variance that need not be in modes; it is in `rest`; `besides` (n_nodes,):
        variance along each axis that no root has, mm^2.
        """
        flat = roots.reshape(len(roots), -1)
        values, vectors = np.linalg.eigh(flat @ flat.T)
        shares = np.cumsum(np.maximum(values[::-1], 0.0))
        n_kept = 1 + int(np.searchsorted(shares, (1.0 - left_out) * shares[-1]))
        kept = np.arange(len(values))[::-1][:n_kept]
        modes = (vectors[:, kept].T @ flat).reshape(len(kept), *roots.shape[1:])
        rest = np.maximum(np.sum(roots**2, axis=0) - np.sum(modes**2, axis=0), 0.0) + np.reshape(besides, (-1, 1))
        return cls(modes.astype(np.float32), rest.astype(np.float32), doubt.astype(np.float32), tail)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of every node, (n_nodes, 3, 3), mm^2."""
        return self.at(np.arange(len(self.rest))[:, None], np.ones((len(self.rest), 1)))

    @property
    def std(self) -> FloatArray:
        """Root of the trace of every node's covariance, (n_nodes,), mm."""
        square = np.einsum("knx,knx->n", self.modes, self.modes, dtype=np.float64)
        return np.asarray(np.sqrt(square + self.rest.sum(axis=1, dtype=np.float64)))

    def at(self, nodes: IntArray, weights: FloatArray) -> FloatArray:
        """Return the covariances (n, 3, 3), mm^2, of points interpolated from nodes (n, k) with weights (n, k)."""
        found = np.zeros((len(nodes), 3, 3))
        for mode in self.modes:
            moved = np.einsum("pk,pkx->px", weights, mode[nodes].astype(np.float64))
            found += moved[:, :, None] * moved[:, None]
        found[:, [0, 1, 2], [0, 1, 2]] += np.einsum("pk,pkx->px", np.abs(weights), self.rest[nodes].astype(np.float64))
        return found

    def untold(self, nodes: IntArray, weights: FloatArray) -> BoolArray:
        """Return whether the markers say too little of points (n,), interpolated from nodes as in `at`."""
        return np.asarray(np.einsum("pk,pk->p", np.abs(weights), self.doubt[nodes].astype(np.float64)) > 0.0)

    def times(self, factor: float) -> "Deviations":
        """Return the uncertainty with all covariances times `factor`."""
        root = np.float32(np.sqrt(factor))
        return Deviations(root * self.modes, np.float32(factor) * self.rest, self.doubt, self.tail)


__all__ = ["Deviations"]
