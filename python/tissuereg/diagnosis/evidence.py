"""Exact log Bayes factors of linear-Gaussian hypotheses against the null hypothesis, and probabilities from them.

With whitened residual r, nuisance columns N and a cause's columns A (all times their prior standard deviations),

    r ~ N(0, C0),  C0 = I + N N^T          without the cause (null hypothesis),
    r ~ N(0, C0 + A A^T)                   with it,

and the log Bayes factor is 1/2 b^T M^-1 b - 1/2 log det M with b = A^T C0^-1 r and M = I + A^T C0^-1 A. Residuals and
columns are first multiplied by C0^-1/2 ("reduced"), which integrates the nuisances out; C0 is then the identity.
"""

from collections.abc import Iterable, Mapping
from itertools import accumulate, pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import gumbel_r, norm

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.settings import DEFAULT


class Null:
    """The covariance of whitened data without any cause: ``C0 = I + N N^T``, noise and nuisances.

    `nuisances` (n_nuisances, size): N^T, whitened changes by one prior standard deviation of each nuisance parameter.
    """

    def __init__(self, nuisances: FloatArray) -> None:
        self.nuisances = nuisances
        _, spread, self._modes = np.linalg.svd(nuisances, full_matrices=False)
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + spread**2)

    def reduced(self, white: FloatArray) -> FloatArray:
        """Return whitened vectors (..., size) times C0^-1/2, where C0 is the covariance of noise and nuisances."""
        return np.asarray(white - ((white @ self._modes.T) * self._shrink) @ self._modes)


def fit_amplitudes(residual: FloatArray, columns: FloatArray) -> tuple[float, FloatArray]:
    """Return the log Bayes factor of one hypothesis against no cause, nats, and its amplitudes, by linear regression.

    `residual` (size,), `columns` (p, size): of the data, and changes by one prior standard deviation of each amplitude,
    both whitened by noise and nuisances (`Null.reduced`). The amplitudes (p,) are posterior means in prior deviations.
    """
    inner = np.eye(len(columns)) + columns @ columns.T
    factor = cho_factor(inner, lower=True)
    along = columns @ residual
    mean = cho_solve(factor, along)
    return float(0.5 * along @ mean - np.log(np.diag(factor[0])).sum()), mean


class Blocks:
    """Many hypotheses with the same number of columns, factored once for any number of residuals.

    `columns` (n_blocks, p, size): changes by one prior standard deviation of each amplitude, whitened by noise and
    nuisances (`Null.reduced`), in the precision of the products: float32 in a bank; `positive`: whether the one
    amplitude (p = 1) cannot be negative: its prior is then half-normal.
    """

    def __init__(self, columns: FloatArray, *, positive: bool = False) -> None:
        self.columns = columns
        self.positive = positive
        n_blocks, p, _ = columns.shape
        inner = np.array([block @ block.T for block in columns], np.float64).reshape(n_blocks, p, p) + np.eye(p)
        lower = np.linalg.cholesky(inner)
        self._logdet = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        self._inverse = np.linalg.inv(lower)

    def log_bayes_factors(self, residuals: FloatArray) -> FloatArray:
        """Return the log Bayes factors (n, n_blocks), in nats, of all hypotheses against no cause.

        `residuals` (n, size): whitened by noise and nuisances.
        """
        n_blocks, p, size = self.columns.shape
        along = residuals.astype(self.columns.dtype) @ self.columns.reshape(-1, size).T
        along = along.astype(np.float64).reshape(-1, n_blocks, p)
        half = np.einsum("kij,nkj->nki", self._inverse, along, optimize=True)
        log_factor = 0.5 * (half**2).sum(axis=-1) - self._logdet
        if self.positive:
            log_factor += np.log(2.0) + norm.logcdf(half[..., 0])
        return np.asarray(log_factor)


def slices_of(sizes: Iterable[int]) -> list[slice]:
    """Return where the parameters of causes of these sizes lie in the vector x, whose first entry is the modulus."""
    return [slice(first, last) for first, last in pairwise(accumulate(sizes, initial=1))]


def rms(values: FloatArray) -> float:
    """Return the root mean square of an array of any shape; 0 where it is empty."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def log_mean_exp(values: FloatArray, axis: int = -1) -> FloatArray:
    """Return the logarithm of the mean of ``exp(values)`` along an axis, which the result lacks."""
    top = values.max(axis=axis, keepdims=True)
    return np.asarray(np.squeeze(top, axis) + np.log(np.exp(values - top).mean(axis=axis)))


def tail_probability(value: float, drawn: FloatArray) -> float:
    """Return the probability of a value at least as large, by n draws (n,) of it and, beyond them, a Gumbel tail."""
    share = float((drawn >= value).mean())
    # Maxima follow a Gumbel distribution; its tail extends the p-value beyond the number of draws.
    width = float(drawn.std()) * np.sqrt(6.0) / np.pi
    tail = float(gumbel_r.sf(value, drawn.mean() - np.euler_gamma * width, width))
    return max(share, tail) if share > 0.0 else min(tail, 1.0 / len(drawn))


def probabilities(log_bayes_factors: Mapping[str, float], temper: float = DEFAULT.evidence.temper) -> dict[str, float]:
    """Return the posterior probability of every cause by id and, under an empty name, of no cause.

    `log_bayes_factors`: against no cause, nats, by id. Prior probabilities are equal; the results are proportional to
    ``exp(log_bayes_factor / temper)`` and have the sum 1.
    """
    names = ["", *log_bayes_factors]
    logs = np.array([0.0, *log_bayes_factors.values()]) / temper
    weights = np.exp(logs - logs.max())
    return dict(zip(names, (weights / weights.sum()).tolist(), strict=True))
