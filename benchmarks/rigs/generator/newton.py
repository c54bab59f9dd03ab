"""Newton's method for both solvers: one step from a state to the next equilibrium, with as few factors as suffice."""

import numpy as np

#: Forces out of balance, as a share of those that hold the body, or mN where these are small.
SHARE, LEAST = 4e-6, 1e-4


class NoEquilibriumError(Exception):
    """Newton's method found no equilibrium."""


class Tangent:
    """The last tangent, used again while it serves."""

    def __init__(self):
        self.multiply = self.solve = self.free = None

    def renew(self, solver, u, free):
        """Take the tangent of a state."""
        self.multiply, self.solve = solver.tangent(u, free)
        self.free = free.copy()

    def copy(self):
        """Return another that can be renewed."""
        other = Tangent()
        other.multiply, other.solve, other.free = self.multiply, self.solve, self.free
        return other


def step(solver, u, free, given, tangent=None, most=40):
    """Return the equilibrium whose components outside `free` (n, 3) are those of `given`, from the state u.

    Raises
    ------
    NoEquilibriumError
        If steps as small as 1/16 do not converge.
    """
    tangent = tangent or Tangent()
    if tangent.free is None or not np.array_equal(tangent.free, free):
        tangent.solve = None
    done, share = 0.0, 1.0
    while done < 1.0 - 1e-12:
        target = min(done + share, 1.0)
        wanted = np.where(free, 0.0, u + (given - u) * (target - done) / (1.0 - done))
        try:
            u = _newton(solver, u, free, wanted, tangent, most)
            done = target
        except NoEquilibriumError:
            tangent.solve = None
            share *= 0.5
            if share < 1 / 17:
                raise
    return u


def _newton(solver, u, free, wanted, tangent, most):
    fresh = tangent.solve is None
    if fresh:
        tangent.renew(solver, u, free)
    change = np.where(free, 0.0, wanted - u)
    r = solver.residual(u)
    if np.abs(change).max() > 0:
        # The tangent carries the patches' motion into the body, so that no element is crushed on the way.
        change = change - tangent.solve(np.where(free, r + tangent.multiply(change), 0.0))
        u = u + change
        r = solver.residual(u)
    if not np.isfinite(r).all():
        raise NoEquilibriumError
    size = norm = np.linalg.norm(r[free])
    for _ in range(most):
        limit = max(SHARE * np.linalg.norm(r[~free]), LEAST)
        if norm < limit:
            return u
        du = -tangent.solve(np.where(free, r, 0.0))
        length = 1.0
        while True:
            trial = solver.residual(u + length * du)
            new = np.linalg.norm(trial[free]) if np.isfinite(trial).all() else np.inf
            if new < 0.98 * norm or (length < 0.2 and np.isfinite(new)) or length < 0.02:
                break
            if not fresh:
                break
            length *= 0.5
        if not fresh and new > 0.3 * norm and new > limit:
            if new < norm:
                u, r, norm = u + length * du, trial, new
            tangent.renew(solver, u, free)
            fresh = True
            continue
        if not np.isfinite(new) or new > 1e3 * size:
            raise NoEquilibriumError
        slow = new > 0.2 * norm
        u, r, norm = u + length * du, trial, new
        fresh = False
        if slow and norm > limit:
            tangent.renew(solver, u, free)
            fresh = True
    raise NoEquilibriumError
