"""Inelastic behaviour of a material, and springs on the surface of a body.

Fields have the names of the keys of an experiment's ``[[effect]]`` tables: ``RelaxationLaw(g=[0.3], tau_s=[2.0])``
corresponds to such a table. Ranges are checked by the solver.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import index_array


@dataclass(frozen=True)
class RelaxationLaw:
    """Stress relaxation by a Prony series, a sum of exponentials in time; moduli are the instantaneous ones.

    `g` (n_terms,): share of the stress that each term relaxes, each above 0, with a sum below 1; `tau_s` (n_terms,):
    relaxation time of each term in s; `part`: which part of the stress relaxes, "whole" or "isochoric".
    """

    g: Sequence[float]
    tau_s: Sequence[float]
    part: str = "whole"


@dataclass(frozen=True)
class RateLaw:
    """Viscous Cauchy stress ``2 eta D``, added to the elastic one, with viscosity eta and rate of deformation D.

    `viscosity_kpa_s`: the viscosity ``eta`` in kPa s.
    """

    viscosity_kpa_s: float


@dataclass(frozen=True)
class SofteningLaw:
    """Softening of the stress by the largest strain energy density ``Wm`` that a point has had so far.

    `r`: at most the share ``1/r`` of the stress is lost with "ogden-roxburgh", and ``1 - 1/r`` with "damage"; at least
    1; `m_kpa`: energy density ``m`` over which small loads soften, in kPa; `beta`: share of ``Wm`` added to ``m``, 0
    for damage; `form`: "ogden-roxburgh" or "damage". The first is the Mullins effect: below the largest isochoric
    energy the isochoric stress is multiplied by ``1 - erf((Wm - W) / (m + beta Wm)) / r`` with the present energy ``W``
    (Ogden and Roxburgh, Proc. R. Soc. A 455, 1999); first loading is unaffected. With damage the whole stress, under a
    first load too, is multiplied by ``1 - (1 - 1/r) (1 - exp(-Wm/m))`` with the whole energy (after Simo, Comput.
    Methods Appl. Mech. Eng. 60, 1987).
    """

    r: float
    m_kpa: float
    beta: float = 0.0
    form: str = "ogden-roxburgh"


@dataclass(frozen=True)
class SetLaw:
    """Permanent set: a share of the largest strain so far remains without load; it acts from the next frame on.

    `fraction`: that share, in (0, 1).
    """

    fraction: float


@dataclass(frozen=True)
class DrainageLaw:
    """Relaxation of a share of the volumetric stress, as a simple model of fluid that drains from the body.

    `share`: share of the volumetric stress that relaxes, in (0, 1); `tau_s`: relaxation time in s.
    """

    share: float
    tau_s: float


@dataclass(frozen=True)
class SwellingLaw:
    """Isotropic, uniform growth of the unloaded body, linear in time between two times.

    `linear_strain`: strain of all lengths at the end, above -1; `from_time_s`, `to_time_s`: start and end in s.
    """

    linear_strain: float
    from_time_s: float
    to_time_s: float


@dataclass(frozen=True)
class Behaviour:
    """Inelastic behaviour of a material; it is purely elastic if all fields are None.

    `relaxation`: stress relaxation; `rate`: viscous stress; `softening`: softening by earlier load; `set`: permanent
    strain; `drainage`: relaxation of the volumetric stress; `swelling`: growth. A field that is None does not act.
    """

    relaxation: RelaxationLaw | None = None
    rate: RateLaw | None = None
    softening: SofteningLaw | None = None
    set: SetLaw | None = None
    drainage: DrainageLaw | None = None
    swelling: SwellingLaw | None = None

    def core(self) -> _core.Behaviour:
        """Return these laws as an object of the compiled solver, which checks their ranges when it uses them."""
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
        return _core.Behaviour(**numbers)


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
    """A set of springs between triangles of the surface and their undeformed place.

    `triangles` (n, 3): boundary triangles, as node numbers; `normal_kpa_per_mm`: stiffness along the undeformed normal,
    in kPa/mm; `tangential_kpa_per_mm`: stiffness in the plane, in kPa/mm; `friction`: coefficient of Coulomb friction,
    or None for springs that do not slip: the traction of the springs in the plane is at most the cohesion plus this
    coefficient times the pressure of the normal springs; `cohesion_kpa`: traction in kPa that holds without pressure;
    used with friction only.
    """

    triangles: Any
    normal_kpa_per_mm: float
    tangential_kpa_per_mm: float
    friction: float | None = None
    cohesion_kpa: float = 0.0

    def as_tuple(self) -> tuple[Any, list[float]]:
        """Return the springs as the compiled solver takes them: triangles (n, 3) and a list of two or four numbers.

        The list holds normal and tangential stiffness in kPa/mm, followed by the friction coefficient and the cohesion
        in kPa if there is friction.
        """
        numbers = [float(self.normal_kpa_per_mm), float(self.tangential_kpa_per_mm)]
        if self.friction is not None:
            numbers += [float(self.friction), float(self.cohesion_kpa)]
        return index_array("springs", self.triangles, (None, 3)), numbers
