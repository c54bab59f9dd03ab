"""Inelastic behaviour of a material, and springs and membranes on the surface of a body.

Fields have the names of the keys of an experiment's ``[[effect]]`` tables: ``RelaxationLaw(g=[0.3], tau_s=[2.0])``
corresponds to such a table. Ranges are checked by the solver.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import index_array


@dataclass(frozen=True)
class RelaxationLaw:
    """Stress relaxation, as a Prony series; moduli are instantaneous.

    `g`: share of the stress that each term relaxes; above 0, sum below 1; `tau_s`: relaxation time of each term in s;
    `part` {"whole", "isochoric"}: which part of the stress relaxes.
    """

    g: Sequence[float]
    tau_s: Sequence[float]
    part: str = "whole"


@dataclass(frozen=True)
class RateLaw:
    """Viscous stress ``2 eta D``, added to the elastic Cauchy stress. `viscosity_kpa_s`: viscosity ``eta`` in kPa s."""

    viscosity_kpa_s: float


@dataclass(frozen=True)
class SofteningLaw:
    """Softening by the largest energy so far, `Wm`.

    `r`: largest softening is ``1 - 1/r``; at least 1; `m_kpa`: energy over which small loads soften, in kPa; `beta`:
    share of the largest energy added to it; 0 for damage; `form` {'ogden-roxburgh', 'damage'}: the Mullins effect:
    below the largest isochoric energy the isochoric stress is multiplied by ``1 - erf((Wm - W) / (m + beta Wm)) / r``;
    first loading is unaffected (Ogden and Roxburgh, Proc. R. Soc. A 455, 1999). Damage: the whole stress, under a first
    load too, is multiplied by ``1 - (1 - 1/r) (1 - exp(-Wm/m))`` with the whole energy (after Simo, Comput. Methods
    Appl. Mech. Eng. 60, 1987).
    """

    r: float
    m_kpa: float
    beta: float = 0.0
    form: str = "ogden-roxburgh"


@dataclass(frozen=True)
class SetLaw:
    """Permanent set: a share of the largest strain remains; it acts from the next frame on. `fraction`: in (0, 1)."""

    fraction: float


@dataclass(frozen=True)
class DrainageLaw:
    """Relaxation of the volumetric stress, as a simple model of drainage.

    `share`: share that drains, in (0, 1); `tau_s`: relaxation time in s.
    """

    share: float
    tau_s: float


@dataclass(frozen=True)
class SwellingLaw:
    """Isotropic, uniform growth along a ramp in time.

    `linear_strain`: strain at the end of the ramp, above -1; `from_time_s`: start of the ramp in s; `to_time_s`: end of
    the ramp in s.
    """

    linear_strain: float
    from_time_s: float
    to_time_s: float


@dataclass(frozen=True)
class Behaviour:
    """Inelastic behaviour of a material; purely elastic if all are None.

    `relaxation`: stress relaxation; `rate`: viscous stress; `softening`: softening by earlier load; `set`: permanent
    strain; `drainage`: relaxation of the volumetric stress; `swelling`: growth.
    """

    relaxation: RelaxationLaw | None = None
    rate: RateLaw | None = None
    softening: SofteningLaw | None = None
    set: SetLaw | None = None
    drainage: DrainageLaw | None = None
    swelling: SwellingLaw | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what the compiled solver takes. Result: parameters of every behaviour that is present."""
        numbers: dict[str, Any] = {}
        if self.relaxation is not None:
            g, tau = ([float(v) for v in np.atleast_1d(x)] for x in (self.relaxation.g, self.relaxation.tau_s))
            numbers["relaxation"] = (g, tau, self.relaxation.part)
        if self.rate is not None:
            numbers["viscosity_kpa_s"] = float(self.rate.viscosity_kpa_s)
        if self.softening is not None:
            soft = self.softening
            numbers["softening"] = (soft.form, soft.r, soft.m_kpa, soft.beta)
        if self.set is not None:
            numbers["set"] = self.set.fraction
        if self.drainage is not None:
            numbers["drainage"] = (self.drainage.share, self.drainage.tau_s)
        if self.swelling is not None:
            ramp = self.swelling
            numbers["swelling"] = (ramp.linear_strain, ramp.from_time_s, ramp.to_time_s)
        return numbers


#: The law of each behaviour, by the field of `Behaviour` that holds it: the id of its effect.
LAWS: dict[str, type[Any]] = {
    "relaxation": RelaxationLaw,
    "rate": RateLaw,
    "softening": SofteningLaw,
    "set": SetLaw,
    "drainage": DrainageLaw,
    "swelling": SwellingLaw,
}


@dataclass(frozen=True, eq=False)
class Springs:
    """Springs between triangles of the surface and their undeformed place.

    `triangles` (n, 3): boundary triangles; `normal_kpa_per_mm`: stiffness along the undeformed normal, in kPa/mm;
    `tangential_kpa_per_mm`: stiffness in the plane, in kPa/mm; `friction`: coefficient of Coulomb friction: the
    traction of the springs in the plane is at most the cohesion plus this coefficient times the pressure of the normal
    springs; `cohesion_kpa`: traction that holds without pressure; used with friction only.
    """

    triangles: Any
    normal_kpa_per_mm: float
    tangential_kpa_per_mm: float
    friction: float | None = None
    cohesion_kpa: float = 0.0

    def as_tuple(self) -> tuple[Any, list[float]]:
        """Return what the compiled solver takes.

        Result: triangles and stiffness, followed by coefficient and cohesion if there is friction.
        """
        numbers = [float(self.normal_kpa_per_mm), float(self.tangential_kpa_per_mm)]
        if self.friction is not None:
            numbers += [float(self.friction), float(self.cohesion_kpa)]
        return index_array("springs", self.triangles, (None, 3)), numbers
