"""Causes that replace a believed neo-Hookean law by another one: Mooney-Rivlin, asymmetry, stiffening.

The believed neo-Hookean law is coupled: its energy is not split into isochoric and volumetric parts. A coupled law of
another kind contains it as a special case of the shape parameter (it is nested); a split law also changes the
volumetric response, similar to another Poisson's ratio. The bank holds the nested form, the fit tries the split one
too.
"""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters, logistic, logit
from tissuereg.experiment.effects import Asymmetry, Effect, Mooney, Stiffening


class LawCause(Cause):
    """Laws that contain the believed one at a shape parameter of zero; changes are simulated at one or more values."""

    discrete: ClassVar[tuple[str, ...]] = ("law",)

    #: Laws and values of the shape parameter at which changes are simulated.
    tried: ClassVar[tuple[tuple[str, float], ...]]

    @abstractmethod
    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a law with a shape parameter, in a form of `Material.volumetric`."""

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return hypotheses for all laws in the nested form; none where the believed law is not neo-Hookean.

        `bench`: the believed model and its sensitivities. Columns of a hypothesis are (p, size), in mm and mN.
        """
        for form in _forms(bench)[:1]:
            changes = bench.changes([[self.effect(law, size, form)] for law, size in self.tried])
            for (law, size), changed in zip(self.tried, changes, strict=True):
                if changed is not None:
                    settings = {"law": law, "size": size, "volumetric": form}
                    yield Variant(f"{law} {size:g}", changed[None], settings, positive=True)

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same law in the other volumetric forms.

        `bench`: the believed model; `variant`: hypothesis that was screened; the ones returned are fitted beside it.
        """
        return tuple(replace(variant, settings={**variant.settings, "volumetric": form}) for form in _forms(bench)[1:])


def _forms(bench: Bench) -> tuple[str, ...]:
    """Return the volumetric forms of other laws, the nested one first; none where the law is not neo-Hookean."""
    material = bench.experiment.material
    if material.law != "neo-hookean":
        return ()
    return ("quadratic",) if material.volumetric == "quadratic" else ("coupled", "log")


MOONEY = "mooney-rivlin"


class MooneyCause(LawCause):
    """The Mooney-Rivlin law."""

    id: ClassVar[str] = "mooney"
    tried: ClassVar[tuple[tuple[str, float], ...]] = ((MOONEY, 0.5),)

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return the law with a share."""
        return Mooney(law=law, volumetric=form, **shape_of(law, size))

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logit of the share.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        form = str(variant.settings["volumetric"])
        return free_parameters(
            [(logit(0.5 * float(amplitudes[0])), 0.0, 1.5, 0.1)],
            lambda x, young: (self.effect(MOONEY, logistic(x[0]), form),),
            lambda x, young: {"law": MOONEY, main_key(MOONEY): logistic(x[0]), "volumetric": form},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        return f"A share of {values[main_key(MOONEY)]:.2g} of the energy follows the second invariant (Mooney-Rivlin)."


#: Exponent at which Ogden's law is the neo-Hookean one, and distances from it at which changes are simulated.
EVEN = 2.0
DISTANCES = (-12.0, 10.0)

#: Excesses of a bimodular law at which changes are simulated.
EXCESSES = (-0.4, 0.7)


class AsymmetryCause(LawCause):
    """Ogden's law with one term, or a bimodular law, whose tension and compression differ at the smallest strain.

    Ogden's law is stiffer in compression for negative exponents, in tension for large positive ones.
    """

    id: ClassVar[str] = "asymmetry"
    tried: ClassVar[tuple[tuple[str, float], ...]] = (
        *(("ogden", distance) for distance in DISTANCES),
        *(("bimodular", excess) for excess in EXCESSES),
    )

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a bimodular law of some excess, or Ogden's law at some distance from the neo-Hookean exponent."""
        if law == "bimodular":
            return Asymmetry(law=law, volumetric=form, **shape_of(law, size))
        exponent = EVEN + size
        if abs(exponent) < 0.1:
            exponent = 0.1 if exponent >= 0 else -0.1
        return Asymmetry(law=law, alpha=(exponent,), weight=(1.0,), volumetric=form)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the exponent's distance from the neo-Hookean one, or the logarithm of the stiffness in tension.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        form, law = str(variant.settings["volumetric"]), str(variant.settings["law"])
        start = float(variant.settings["size"]) * min(max(float(amplitudes[0]), 0.1), 2.0)
        if law == "ogden":
            return free_parameters(
                [(start, 0.0, 12.0, 0.5)],
                lambda x, young: (self.effect(law, float(x[0]), form),),
                lambda x, young: {"law": law, "alpha": [EVEN + float(x[0])], "volumetric": form},
            )
        return free_parameters(
            [(float(np.log1p(start)), 0.0, 0.7, 0.05)],
            lambda x, young: (self.effect(law, float(np.expm1(x[0])), form),),
            lambda x, young: {"law": law, main_key(law): float(np.expm1(x[0])), "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same exponent with the other volumetric forms; a bimodular law has one form.

        `bench`: the believed model; `variant`: hypothesis that was screened; the ones returned are fitted beside it.
        """
        return () if variant.settings["law"] == "bimodular" else super().alternatives(bench, variant)

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        if values["law"] == "bimodular":
            factor = 1.0 + values[main_key("bimodular")]
            return f"Stretched directions of the body have {factor:.3g} times the stiffness of compressed ones."
        exponent = values["alpha"][0]
        side = "compression" if exponent < 0 else "tension"
        return f"The body is stiffer in {side} than the believed law (Ogden's exponent {exponent:.3g})."


#: Laws, and values of their first shape parameter where secants are taken: exponents of Fung's law, a ratio of Yeoh's.
#: Skin has exponents of some tens.
TRIED = {"fung": (1.0, 4.0, 16.0), "yeoh": (2.0,)}

#: Largest logarithm of a shape parameter; a strain of 0.1 then multiplies the modulus by some thousands.
LARGEST = 7.0


class StiffeningCause(LawCause):
    """Fung's exponential law or Yeoh's polynomial law in place of the neo-Hookean one."""

    id: ClassVar[str] = "stiffening"
    tried: ClassVar[tuple[tuple[str, float], ...]] = tuple(
        (law, size) for law, sizes in TRIED.items() for size in sizes
    )

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a law by its first shape parameter, the others zero."""
        return Stiffening(law=law, volumetric=form, **shape_of(law, size))

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logarithm of the law's shape parameter.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        law, size = str(variant.settings["law"]), float(variant.settings["size"])
        form = str(variant.settings["volumetric"])
        start = float(np.log(size * np.clip(amplitudes[0], 0.1, 3.0)))
        return free_parameters(
            [(start, float(np.log(2.0)), 1.2, 0.05)],
            lambda x, young: (self.effect(law, _shape(x), form),),
            lambda x, young: {"law": law, main_key(law): _shape(x), "volumetric": form},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        key = main_key(str(values["law"]))
        return f"The body stiffens with strain ({key} = {values[key]:.3g}): large pushes meet more than is believed."


def _shape(x: FloatArray) -> float:
    return float(np.exp(min(x[0], LARGEST)))
