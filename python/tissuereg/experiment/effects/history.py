"""Effects of the body's load history: relaxation, viscosity, softening, permanent set, swelling, drainage."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg._base.fields import choice, number, numbers
from tissuereg.experiment.effects.base import Effect, refuse
from tissuereg.experiment.experiment import Experiment


@dataclass(frozen=True, kw_only=True)
class Memory(Effect):
    """Base of effects of the load history, which the solver computes while a load case runs through time."""

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment unchanged: the solver reads this effect itself."""
        return experiment


@dataclass(frozen=True, kw_only=True)
class Relaxation(Memory):
    """Prony series: shares `g` of the stress relax over the times `tau_s`; the modulus is the instantaneous one.

    `part`: whether the whole stress relaxes or its isochoric part alone; times are in s.
    """

    id: ClassVar[str] = "relaxation"
    of_specimen: ClassVar[bool] = True
    g: tuple[float, ...] = numbers("shares of the stress that relax; their sum is less than 1", above=0.0, below=1.0)
    tau_s: tuple[float, ...] = numbers("their time constants", above=0.0)
    part: str = choice(("whole", "isochoric"), "stress that relaxes", default="whole")

    def check(self) -> None:
        """Raise an error if `g` and `tau_s` differ in length, or the shares `g` add up to 1 or more."""
        if len(self.g) != len(self.tau_s):
            refuse("`g` and `tau_s` must be of one length", [len(self.g), len(self.tau_s)])
        if sum(self.g) >= 1.0:
            refuse("the sum of `g` must be less than 1", list(self.g))


@dataclass(frozen=True, kw_only=True)
class Rate(Memory):
    """A viscous stress that grows with the rate of strain."""

    id: ClassVar[str] = "rate"
    of_specimen: ClassVar[bool] = True
    absolute: ClassVar[bool] = True
    viscosity_kpa_s: float = number("viscosity", least=0.0)


@dataclass(frozen=True, kw_only=True)
class Softening(Memory):
    """Softening of the stress by the largest strain energy that the material has had so far (Mullins effect, damage).

    The stress is multiplied by a factor that depends on the present strain energy density and the largest one so far;
    `tissuereg.simulation.behaviour.SofteningLaw` has its formula.
    """

    id: ClassVar[str] = "softening"
    of_specimen: ClassVar[bool] = True
    absolute: ClassVar[bool] = True
    r: float = number("Ogden and Roxburgh's r: at most 1/r of the stress is lost", least=1.0)
    m_kpa: float = number("energy over which it is lost", above=0.0)
    beta: float = number("dependence of that energy on the largest one so far", least=0.0, default=0.0)
    form: str = choice(
        ("ogden-roxburgh", "damage"),
        "loss on unloading (Mullins effect), or damage under a first load too",
        default="ogden-roxburgh",
    )

    def check(self) -> None:
        """Raise an error if `beta` is not 0 although `form` is ``damage``."""
        if self.form == "damage" and self.beta != 0.0:
            refuse("`beta` must be 0 for damage", self.beta)


@dataclass(frozen=True, kw_only=True)
class Set(Memory):
    """Permanent set: a share of the largest strain so far stays when the load is gone."""

    id: ClassVar[str] = "set"
    of_specimen: ClassVar[bool] = True
    fraction: float = number("share of the largest strain so far that stays", above=0.0, below=1.0)


@dataclass(frozen=True, kw_only=True)
class Swelling(Memory):
    """Growth of all lengths by `linear_strain`, at a constant rate from one time to another; negative: drying.

    Bonded pads hold their patches in place against the growth, or move as the free body would grow there.
    """

    id: ClassVar[str] = "swelling"
    linear_strain: float = number("growth of all lengths; negative: drying", above=-1.0)
    from_time_s: float = number("when it begins")
    to_time_s: float = number("when it ends")
    pads: str = choice(
        ("hold", "follow"), "whether bonded pads hold their patches against it or follow the growth", default="hold"
    )

    def check(self) -> None:
        """Raise an error if `to_time_s` is not after `from_time_s`."""
        if self.to_time_s <= self.from_time_s:
            refuse("`to_time_s` must lie after `from_time_s`", [self.from_time_s, self.to_time_s])

    def share(self, times: FloatArray) -> FloatArray:
        """Return the share (n,) of the growth, from 0 to 1, that is done at times (n,) in s."""
        return np.clip((times - self.from_time_s) / (self.to_time_s - self.from_time_s), 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Drainage(Memory):
    """A share of the volumetric stress relaxes: a simple substitute for fluid that drains from the body."""

    id: ClassVar[str] = "drainage"
    share: float = number("share of the volumetric stress", above=0.0, below=1.0)
    tau_s: float = number("time constant of its relaxation", above=0.0)
