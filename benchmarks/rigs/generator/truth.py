"""What is true of a rig in one experiment: the law, its parameters in space and time, how it is held and moved."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Memory:
    """Dependence of the stress on time and history.

    `relaxing`, `draining`: shares and times of terms, of all stress and of its volumetric part; `viscosity`: kPa s;
    `damage`: (share, m_kpa, whether it counts on unloading alone); `kept`: share of the largest
    strain that stays, and the points' weights (or None).
    """

    relaxing: tuple = ()
    draining: tuple = ()
    viscosity: float = 0.0
    damage: tuple | None = None
    kept: tuple | None = None

    @property
    def carried(self):
        """Whether it is carried from one load case to the next."""
        return bool(self.damage or self.kept)


@dataclass
class Truth:
    """Differences from the believed rig; the moduli are in units of the rig's believed ones.

    `contrast`: factor on the moduli at points (n, 3); `weight` (3,): mN/mm^3; `growth`: stretch less one at a time and
    points; `support`: None, or a dictionary (`springs`, `limit`, `off`); `motion`: (pad, share, stroke) -> shift (3,)
    and matrix (3, 3) about the pad's centre; `wall`: (normal, place, stiffness); `thread`: (points -> weight, kPa/mm).
    """

    law: tuple | None = None
    poisson: float | None = None
    contrast: Callable | None = None
    weight: np.ndarray | None = None
    growth: Callable | None = None
    support: dict | None = None
    motion: Callable | None = None
    wall: tuple | None = None
    thread: tuple | None = None
    memory: Memory = field(default_factory=Memory)
    young: float = 1.0

    @property
    def timed(self):
        """Whether the frames must be solved in order."""
        memory = self.memory
        return bool(memory.relaxing or memory.draining or memory.viscosity or memory.carried or self.growth)


def moduli(rig, truth):
    """Return (mu, lambda, K) in kPa of the believed modulus and the true ratio."""
    young, nu = rig.young[0] * truth.young, rig.poisson if truth.poisson is None else truth.poisson
    mu = young / (2 * (1 + nu))
    lam = young * nu / ((1 + nu) * (1 - 2 * nu))
    return mu, lam, lam + 2 * mu / 3


def motion_of(truth, pad, share, stroke):
    """Return shift and matrix of a pad's motion."""
    if truth.motion is None:
        return share * np.asarray(stroke), np.zeros((3, 3))
    return truth.motion(pad, share, np.asarray(stroke))
