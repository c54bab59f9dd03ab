"""Bases that give way: springs, friction, a part that has come off."""

from dataclasses import dataclass

import numpy as np

HOLD = 3000.0


@dataclass
class Springs:
    """Springs along the base and across it, kPa/mm; by default it is held across."""

    stiffness: float
    across: float = HOLD

    def start(self, surface):
        """Return the state of a run."""
        return _State(self, surface)

    def law(self, state, u):
        """Return traction (k, q, 3) and minus its derivative."""
        tie = np.array([self.stiffness, self.stiffness, self.across])
        return -tie * u, np.broadcast_to(np.diag(tie), (*u.shape, 3))

    def end(self, state, u):
        """Nothing is remembered."""


@dataclass
class Friction:
    """Coulomb's law, regularised: sticks by springs up to coefficient x pressure, then slips; a preload presses down.

    Pressure is that of the step before, so that the tangent stays symmetric.
    """

    coefficient: float
    preload_kpa: float
    stick: float = 60.0

    def start(self, surface):
        """Return the state of a run."""
        state = _State(self, surface)
        state.anchor = np.zeros((*surface.dx.shape, 2))
        state.pressure = np.full(surface.dx.shape, self.preload_kpa)
        return state

    def law(self, state, u):
        """Return traction and minus its derivative."""
        stretch = u[..., :2] - state.anchor
        limit = self.coefficient * state.pressure
        size = np.linalg.norm(stretch, axis=-1)
        slips = self.stick * size > limit
        safe = np.where(size > 0, size, 1.0)
        slope = np.where(slips, limit / safe, self.stick)
        slope = np.maximum(slope, 1e-3 * self.stick)
        traction = np.concatenate([-slope[..., None] * stretch, -HOLD * u[..., 2:]], axis=-1)
        matrix = np.zeros((*u.shape, 3))
        matrix[..., 2, 2] = HOLD
        along = stretch / safe[..., None]
        matrix[..., :2, :2] = slope[..., None, None] * np.eye(2)
        matrix[..., :2, :2] -= (
            np.where(slips, 0.95 * slope, 0.0)[..., None, None] * along[..., :, None] * along[..., None, :]
        )
        return traction, matrix

    def end(self, state, u):
        """Let the anchors follow what has slipped; take the new pressure."""
        stretch = u[..., :2] - state.anchor
        limit = self.coefficient * state.pressure
        size = np.linalg.norm(stretch, axis=-1)
        excess = np.maximum(size - limit / self.stick, 0.0)
        state.anchor = state.anchor + stretch * (excess / np.where(size > 0, size, 1.0))[..., None]
        state.pressure = self.preload_kpa + np.maximum(-HOLD * u[..., 2], 0.0)


@dataclass
class Detached:
    """Fixed but for a part (points (…, 3) -> bool) that can lift, and slide, and is stopped below."""

    part: object
    soft: float = 0.0

    def start(self, surface):
        """Return the state of a run."""
        state = _State(self, surface)
        state.off = self.part(surface.points)
        return state

    def law(self, state, u):
        """Return traction and minus its derivative."""
        across = np.where(state.off & (u[..., 2] > 0), self.soft, HOLD)
        along = np.where(state.off, self.soft, HOLD)
        tie = np.stack([along, along, across], axis=-1)
        return -tie * u, tie[..., None] * np.eye(3)

    def end(self, state, u):
        """Nothing is remembered."""


class _State:
    def __init__(self, kind, surface):
        self.kind, self.surface = kind, surface

    def traction(self, u):
        return self.kind.law(self, self.surface.at(u))

    def end(self, u):
        self.kind.end(self, self.surface.at(u))
