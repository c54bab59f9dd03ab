"""Effects on the elastic material of the whole body: moduli, law of strain energy, fibres."""

from dataclasses import dataclass, replace
from typing import ClassVar

from tissuereg._base.choices import Element
from tissuereg._base.fields import choice, flag, number, numbers
from tissuereg.body.material import SHAPE_KEYS, VOLUMETRIC, Material
from tissuereg.body.material import Fibre as Fibres
from tissuereg.errors import MaterialError
from tissuereg.experiment.effects.base import Effect, Vector, refuse
from tissuereg.experiment.experiment import Experiment

#: Meaning of the shape parameters, which the table of laws explains.
_OF_LAW = "shape parameter of the law"

_SHAPES = tuple(dict.fromkeys(key for keys in SHAPE_KEYS.values() for key in keys))


@dataclass(frozen=True, kw_only=True)
class Stiffness(Effect):
    """Young's modulus at small strain in kPa, in place of the believed one; inclusions and layers multiply it."""

    id: ClassVar[str] = "stiffness"
    of_specimen: ClassVar[bool] = True
    absolute: ClassVar[bool] = True
    young_kpa: float = number("Young's modulus at small strain", above=0.0)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with Young's modulus `young_kpa` everywhere."""
        return replace(experiment, material=replace(experiment.material, young=self.young_kpa))


@dataclass(frozen=True, kw_only=True)
class Poisson(Effect):
    """Poisson's ratio at small strain, in place of the believed one."""

    id: ClassVar[str] = "poisson"
    of_specimen: ClassVar[bool] = True
    poisson: float = number("Poisson's ratio at small strain", above=-1.0, below=0.5)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with Poisson's ratio `poisson` everywhere."""
        return replace(experiment, material=replace(experiment.material, poisson=self.poisson))


@dataclass(frozen=True, kw_only=True)
class OtherLaw(Effect):
    """Base of effects by which the strain energy has another law, with the same moduli at small strain.

    `law` names it; its shape parameters, which the table of `Material` defines, must be given and all others be None.
    """

    of_specimen: ClassVar[bool] = True

    law: str = choice(tuple(SHAPE_KEYS), "strain energy")
    excess: float | None = number(_OF_LAW, default=None)
    share: float | None = number(_OF_LAW, least=0.0, default=None)
    c2_over_c1: float | None = number(_OF_LAW, default=None)
    c3_over_c1: float | None = number(_OF_LAW, default=None)
    alpha: tuple[float, ...] | None = numbers(_OF_LAW, default=None)
    weight: tuple[float, ...] | None = numbers(_OF_LAW, default=None)
    b: float | None = number(_OF_LAW, default=None)
    #: As `Material.volumetric`; as believed where left out.
    volumetric: str | None = choice(VOLUMETRIC, "energy of volume change, as believed where left out", default=None)

    def check(self) -> None:
        """Raise an error if a shape parameter of the law is missing, out of range, or belongs to another law."""
        wanted = SHAPE_KEYS[self.law]
        for key in _SHAPES:
            given = getattr(self, key) is not None
            if given and key not in wanted:
                known = ", ".join(wanted) or "none"
                refuse(f"`{key}` must be left out with the law '{self.law}', whose shape parameters are: {known}")
            if key in wanted and not given:
                refuse(f"`{key}` must be given with the law '{self.law}'")
        if self.alpha is not None and self.weight is not None and len(self.alpha) != len(self.weight):
            refuse("`alpha` and `weight` must be of one length", [len(self.alpha), len(self.weight)])
        # `Material` checks the ranges.
        self.of(Material())

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with this law in its material."""
        return replace(experiment, material=self.of(experiment.material))

    def of(self, material: Material) -> Material:
        """Return a copy of a material with this law and its shape parameters."""
        try:
            shape = {key: getattr(self, key) for key in SHAPE_KEYS[self.law]}
            return replace(material, law=self.law, shape=shape, volumetric=self.volumetric or material.volumetric)
        except MaterialError as error:
            refuse(str(error))


@dataclass(frozen=True, kw_only=True)
class Stiffening(OtherLaw):
    """The body stiffens as strain grows.

    `law` names its law of strain energy; the law's shape parameters are fields too; moduli at small strain stay.
    """

    id: ClassVar[str] = "stiffening"


@dataclass(frozen=True, kw_only=True)
class Mooney(OtherLaw):
    """The strain energy depends on the second invariant as well as on the first.

    `law` names its law of strain energy; the law's shape parameters are fields too; moduli at small strain stay.
    """

    id: ClassVar[str] = "mooney"


@dataclass(frozen=True, kw_only=True)
class Asymmetry(OtherLaw):
    """The body responds differently to tension and to compression.

    `law` names its law of strain energy; the law's shape parameters are fields too; moduli at small strain stay.
    """

    id: ClassVar[str] = "asymmetry"


@dataclass(frozen=True, kw_only=True)
class Fibre(Effect):
    """One family of fibres, of stiffness ``k1_over_mu`` shear moduli and exponent ``k2``, along a direction."""

    id: ClassVar[str] = "fibre"
    of_specimen: ClassVar[bool] = True
    k1_over_mu: float = number("stiffness k1 over the shear modulus", least=0.0)
    k2: float = number("rate of stiffening", least=0.0)
    direction: Vector = numbers("of the fibres; only the direction counts", 3, directed=True)
    tension_only: bool = flag("whether shortened fibres are slack", default=True)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with these fibres added to the law of its material."""
        fibre = Fibres(self.k1_over_mu, self.k2, self.direction, self.tension_only)
        return replace(experiment, material=replace(experiment.material, fibre=fibre))
