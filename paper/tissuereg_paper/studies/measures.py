"""Errors of registered meshes, shares of points inside their regions, and intervals of means over pairs."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray

#: 90 % quantile of the chi-square with three degrees of freedom.
_QUANTILE90 = 6.251388631170325

#: Resamples of an interval, and their seed.
_RESAMPLES, _SEED = 2000, 21


@dataclass(frozen=True, eq=False)
class Errors:
    """Distances of the nodes from where they should be, by pair; mm.

    Attributes
    ----------
    mean, rms, largest : ndarray of float64, shape (n_pairs,)
        Over the nodes of a pair.
    """

    mean: FloatArray
    rms: FloatArray
    largest: FloatArray

    @classmethod
    def of(cls, fields: FloatArray, truths: FloatArray) -> "Errors":
        """Return the errors of fields (n_pairs, n_nodes, 3) against their truths, mm."""
        difference = np.subtract(fields, truths, dtype=np.float64)
        distance = np.sqrt(np.einsum("pni,pni->pn", difference, difference))
        return cls(distance.mean(axis=1), np.sqrt((distance**2).mean(axis=1)), distance.max(axis=1))

    @classmethod
    def joined(cls, parts: "list[Errors]") -> "Errors":
        """Return the errors of several lots of pairs as one."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("mean", "rms", "largest")))


def inside90(points: FloatArray, truths: FloatArray, factor: float, own: FloatArray | None = None) -> FloatArray:
    """Return the share of points of every pair whose 90 % region holds the truth.

    Parameters
    ----------
    points : ndarray of float64, shape (n_pairs, n_members, n_points, 3)
        Displacements of the points by the members, mm.
    truths : ndarray of float64, shape (n_pairs, n_points, 3)
        True ones.
    factor : float
        On the covariance, for the finite ensemble.
    own : ndarray of float64, shape (n_points, 3, 3), optional
        Covariance of the model's own error, mm^2.

    Returns
    -------
    ndarray of float64, shape (n_pairs,)
        From 0 to 1.
    """
    centre = points.mean(axis=1)
    away = points - centre[:, None]
    covariance = factor * np.einsum("pmti,pmtj->ptij", away, away) / (points.shape[1] - 1)
    if own is not None:
        covariance = covariance + own
    off = truths - centre
    # A node that hardly moves has next to no spread; a nanometre keeps its covariance invertible.
    square = np.einsum("pti,pti->pt", off, np.linalg.solve(covariance + 1e-12 * np.eye(3), off[..., None])[..., 0])
    return np.asarray((square <= _QUANTILE90).mean(axis=1))


class Clusters:
    """Resampling of pairs by their start meshes and their targets, which pairs share.

    Parameters
    ----------
    starts, targets : ndarray of int64, shape (n_pairs,)
        The shapes of each pair.

    Notes
    -----
    Pigeonhole bootstrap, A. B. Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1, 386-411, 2007: starts
    and targets are drawn with replacement, each on its own, and a pair counts by the product of both counts.
    """

    def __init__(self, starts: IntArray, targets: IntArray) -> None:
        rng = np.random.default_rng(_SEED)
        weights = np.ones((_RESAMPLES, len(starts)))
        for of_pair in (starts, targets):
            names, which = np.unique(of_pair, return_inverse=True)
            counts = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), _RESAMPLES)
            weights *= counts[:, which]
        whole = weights.sum(axis=1)
        self._weights = weights[whole > 0] / whole[whole > 0, None]

    def interval(self, values: FloatArray) -> tuple[float, float]:
        """Return the 95 % interval of the mean of values (n_pairs,)."""
        low, high = np.quantile(self._weights @ values, (0.025, 0.975))
        return float(low), float(high)
