"""Numbers that carry their first and second derivatives in four variables: energies are written once, as formulas."""

import numpy as np


class Jet:
    """A value (...,), its gradient (..., 4) and its second derivatives (..., 4, 4)."""

    __array_ufunc__ = None

    def __init__(self, value, gradient, second):
        self.value, self.gradient, self.second = value, gradient, second

    @classmethod
    def variables(cls, *values):
        """Return the four variables themselves."""
        jets = []
        for k, value in enumerate(values):
            gradient = np.zeros((*value.shape, 4))
            gradient[..., k] = 1.0
            jets.append(cls(value, gradient, np.zeros((*value.shape, 4, 4))))
        return jets

    def through(self, f, df, ddf):
        """Return f(self) from f and its two derivatives at the value."""
        outer = self.gradient[..., :, None] * self.gradient[..., None, :]
        return Jet(f, _times(df, self.gradient, 1), _times(df, self.second, 2) + _times(ddf, outer, 2))

    def __add__(self, other):
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.gradient + other.gradient, self.second + other.second)
        return Jet(self.value + other, self.gradient, self.second)

    def __mul__(self, other):
        if not isinstance(other, Jet):
            return self.through(self.value * other, other, 0.0)
        cross = self.gradient[..., :, None] * other.gradient[..., None, :]
        second = _times(self.value, other.second, 2) + _times(other.value, self.second, 2)
        second = second + cross + np.swapaxes(cross, -1, -2)
        gradient = _times(self.value, other.gradient, 1) + _times(other.value, self.gradient, 1)
        return Jet(self.value * other.value, gradient, second)

    def __pow__(self, n):
        v = self.value
        return self.through(v**n, n * v ** (n - 1), n * (n - 1) * v ** (n - 2))

    def __neg__(self):
        return self * -1.0

    def __sub__(self, other):
        return self + (-other)

    def __rsub__(self, other):
        return -self + other

    def __truediv__(self, other):
        return self * (1.0 / other)

    __radd__, __rmul__ = __add__, __mul__

    def exp(self):
        """Return e to the power of self."""
        e = np.exp(self.value)
        return self.through(e, e, e)

    def log(self):
        """Return the natural logarithm."""
        return self.through(np.log(self.value), 1.0 / self.value, -1.0 / self.value**2)

    def positive(self):
        """Return self where positive, zero elsewhere."""
        on = (self.value > 0).astype(float)
        return self.through(self.value * on, on, 0.0)


def _times(factor, array, extra):
    factor = np.asarray(factor, dtype=float)
    return factor.reshape(factor.shape + (1,) * extra) * array if factor.ndim else factor * array
