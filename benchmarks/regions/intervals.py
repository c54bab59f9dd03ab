"""Interval of a share of targets, where targets of one cluster are not independent.

The share of a cluster is a draw from a beta law of mean m and correlation rho (the share of the variance m (1 - m) that
lies between clusters), and the number of its targets inside a binomial one; m and rho are uniform before. Bootstraps of
so few clusters are too narrow, and have no width where all targets are inside.
"""

from functools import cache

import numpy as np
from scipy.special import betaln, expit

#: Candidates of m, evenly spaced in its logit, and of rho.
_MEANS, _CORRELATIONS = expit(np.linspace(-9.0, 9.0, 601)), (np.arange(100) + 0.5) / 100


@cache
def interval(counts: tuple[tuple[int, int], ...], share: float = 0.95) -> tuple[float, float]:
    """Return the ends of the central interval of m; `counts`: targets inside and all targets of each cluster."""
    a = _MEANS[:, None] * (1.0 / _CORRELATIONS - 1.0)
    b = (1.0 - _MEANS)[:, None] * (1.0 / _CORRELATIONS - 1.0)
    log = sum(betaln(inside + a, n - inside + b) - betaln(a, b) for inside, n in counts)
    # Density in the logit of m, of which the prior is m (1 - m).
    weights = np.exp(log - log.max()).sum(axis=1) * _MEANS * (1.0 - _MEANS)
    # Half of a candidate's own weight lies below it.
    below = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    low, high = np.interp([0.5 - share / 2, 0.5 + share / 2], below, _MEANS)
    return float(low), float(high)
