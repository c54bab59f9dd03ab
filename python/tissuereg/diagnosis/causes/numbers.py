"""Numbers from the free parameters of a cause, which are real numbers without bounds, and back."""

from collections.abc import Sequence

import numpy as np

from tissuereg._base.arrays import FloatArray


def three(vector: FloatArray | Sequence[float]) -> tuple[float, float, float]:
    """Return a vector, shape (3,), as a tuple of three Python floats in the same unit."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


def logistic(x: float) -> float:
    """Return 1 / (1 + exp(-x))."""
    return float(1.0 / (1.0 + np.exp(-x)))


def inner_share(x: float) -> float:
    """Return the logistic function of x, kept within (0, 1) by a margin of 1e-6."""
    return float(1e-6 + (1.0 - 2e-6) / (1.0 + np.exp(-np.clip(x, -40.0, 40.0))))


def exponential(x: float) -> float:
    """Return exp(x) with x clipped to [-40, 40], so that the result is finite."""
    return float(np.exp(np.clip(x, -40.0, 40.0)))


def logit(p: float, edge: float = 0.02) -> float:
    """Return log(p / (1 - p)), the inverse of `logistic`, of a share `p` that is first clipped to [edge, 1 - edge]."""
    p = min(max(p, edge), 1.0 - edge)
    return float(np.log(p / (1.0 - p)))
