"""What the data's body remembers: relaxation, viscosity, softening, set, growth, drainage."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import erf


@dataclass
class Memory:
    """Settings; all off by default.

    Parameters
    ----------
    relaxing : tuple of (g, tau)
        Shares of the whole stress and times in s.
    draining : tuple of (share, tau)
        The same of the volumetric stress alone.
    viscosity : float
        kPa s: S = viscosity dC/dt.
    rate_power : float
        1: linear; less: S grows with |dC/dt|^power.
    softening : tuple, optional
        ("ogden-roxburgh", r, m_kpa, beta) or ("simo", share, m_kpa): the latter depends on the largest energy alone.
    set_share : float
        Of the largest strain so far that stays.
    growth : callable, optional
        time -> linear strain, or (time, points) -> strain where ``points`` are given.
    """

    relaxing: tuple = ()
    draining: tuple = ()
    viscosity: float = 0.0
    rate_power: float = 1.0
    softening: tuple | None = None
    set_share: float = 0.0
    growth: Callable | None = None

    @property
    def timed(self):
        """Whether the path matters."""
        return bool(self.relaxing or self.draining or self.viscosity or self.softening or self.set_share or self.growth)

    def start(self, shape, mu):
        """Return a fresh history of quadrature points."""
        return History(self, shape)


class History:
    """Stress of a step from the strains before it."""

    def __init__(self, memory, shape):
        self.memory = memory
        zero = np.zeros((*shape, 3, 3))
        self.kept = [zero] * len(memory.relaxing)
        self.drained = [zero] * len(memory.draining)
        self.S_before = self.V_before = self.C_before = None
        self.peak = np.zeros(shape)
        self.largest, self.largest_size = zero, np.zeros(shape)
        self.inner = None

    def begin(self, dt, time):
        """Note the time step."""
        self.dt, self.time = dt, time
        m = self.memory
        inner = None
        if m.growth is not None:
            inner = np.eye(3) * (1.0 + np.asarray(m.growth(time)))[..., None, None]
        if m.set_share and self.largest_size.max() > 0:
            values, vectors = np.linalg.eigh(np.eye(3) + 2 * m.set_share * self.largest)
            stretch = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
            inner = stretch if inner is None else inner @ stretch
        self.inner = inner

    def _elastic(self, F, stress, tangent, volume_only=False):
        if self.inner is None:
            return stress(F, tangent, volume_only)
        back = np.linalg.inv(self.inner)
        W, P, A = stress(F @ back, tangent, volume_only)
        size = np.linalg.det(self.inner)
        turned = np.swapaxes(back, -1, -2)
        P = size[..., None, None] * (P @ turned)
        if A is not None:
            A = np.broadcast_to(A, (*F.shape[:-2], 9, 9)).reshape(*F.shape, 3, 3)
            A = np.einsum(
                "...iKjL,...KI,...LJ->...iIjJ",
                A,
                np.broadcast_to(turned, F.shape),
                np.broadcast_to(turned, F.shape),
                optimize=True,
            )
            A = size[..., None, None] * A.reshape(*F.shape[:-2], 9, 9)
        return (None if W is None else W * size), P, A

    def response(self, F, stress, tangent):
        """Return stress and tangent."""
        m = self.memory
        W, P, A = self._elastic(F, stress, tangent)
        if m.softening is not None:
            P, A = self._softened(W, P, A)
        if m.relaxing:
            P, A = self._relaxed(F, P, A, m.relaxing, self.kept, self.S_before)
        if m.draining:
            _, V, B = self._elastic(F, stress, tangent, volume_only=True)
            late, slope = self._relaxed(F, V, B, m.draining, self.drained, self.V_before)
            P, A = P + (late - V), None if A is None else A + (slope - B)
        if m.viscosity and self.C_before is not None and self.dt > 0:
            P, A = self._viscous(F, P, A)
        return P, A

    def _relaxed(self, F, P, A, terms, kept, before):
        share, rest = 1.0, 0.0
        for (g, tau), H in zip(terms, kept, strict=True):
            x = self.dt / tau
            b = (1 - np.exp(-x)) / x if x > 0 else 1.0
            share += g * (b - 1.0)
            rest = rest + np.exp(-x) * H - (g * b * before if before is not None else 0.0)
        P = share * P + F @ rest if np.ndim(rest) else share * P
        if A is not None:
            A = share * A
            if np.ndim(rest):
                A = A + np.einsum("ij,...IJ->...iIjJ", np.eye(3), rest).reshape(A.shape)
        return P, A

    def _viscous(self, F, P, A):
        m = self.memory
        C = np.swapaxes(F, -1, -2) @ F
        rate = (C - self.C_before) / self.dt
        factor = m.viscosity
        if m.rate_power != 1.0:
            # A reference rate of 0.05/s: both forms agree there.
            size = np.sqrt((rate**2).sum(axis=(-1, -2)) + 1e-6)
            factor = (m.viscosity * (size / 0.05) ** (m.rate_power - 1))[..., None, None]
        S = factor * rate
        P = P + F @ S
        if A is not None:
            slope = np.einsum("...iJ,...jI->...iIjJ", F, F)
            slope += np.einsum("...ij,IJ->...iIjJ", F @ np.swapaxes(F, -1, -2), np.eye(3))
            slope *= np.asarray(factor)[..., None, None] / self.dt if np.ndim(factor) else factor / self.dt
            slope += np.einsum("ij,...IJ->...iIjJ", np.eye(3), S)
            A = A + slope.reshape(A.shape)
        return P, A

    def _softened(self, W, P, A):
        kind, *numbers = self.memory.softening
        if kind == "ogden-roxburgh":
            r, m_kpa, beta = numbers
            wide = m_kpa + beta * self.peak
            x = np.maximum(self.peak - W, 0.0) / wide
            factor = 1 - erf(x) / r
            slope = np.where(self.peak > W, 2 / np.sqrt(np.pi) / r * np.exp(-(x**2)) / wide, 0.0)
        else:
            share, m_kpa = numbers
            top = np.maximum(self.peak, W)
            factor = 1 - share * (1 - np.exp(-top / m_kpa))
            slope = np.where(self.peak < W, -share / m_kpa * np.exp(-top / m_kpa), 0.0)
        if A is not None:
            flat = P.reshape(*P.shape[:-2], 9)
            A = factor[..., None, None] * A + slope[..., None, None] * flat[..., :, None] * flat[..., None, :]
        return factor[..., None, None] * P, A

    def end(self, F, stress):
        """Keep what the next step needs."""
        m = self.memory
        if not m.timed:
            return
        W, P, _ = self._elastic(F, stress, tangent=False)
        if m.softening is not None:
            P, _ = self._softened(W, P, None)
            self.peak = np.maximum(self.peak, W)
        if m.relaxing:
            S = np.linalg.solve(F, P)
            self.kept = self._updated(m.relaxing, self.kept, S, self.S_before)
            self.S_before = S
        if m.draining:
            V = np.linalg.solve(F, self._elastic(F, stress, tangent=False, volume_only=True)[1])
            self.drained = self._updated(m.draining, self.drained, V, self.V_before)
            self.V_before = V
        C = np.swapaxes(F, -1, -2) @ F
        self.C_before = C
        if m.set_share:
            E = 0.5 * (C - np.eye(3))
            size = np.sqrt((E**2).sum(axis=(-1, -2)))
            more = size > self.largest_size
            self.largest = np.where(more[..., None, None], E, self.largest)
            self.largest_size = np.where(more, size, self.largest_size)

    def _updated(self, terms, kept, S, before):
        new = []
        for (g, tau), H in zip(terms, kept, strict=True):
            x = self.dt / tau
            b = (1 - np.exp(-x)) / x if x > 0 else 1.0
            change = S - before if before is not None else S
            new.append(np.exp(-x) * H + g * b * change)
        return new
