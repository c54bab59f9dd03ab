"""Tension-compression asymmetry: Ogden's law with one term, or a bimodular law."""

from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Knobs, Values, Variant, knobs
from tissuereg.diagnosis.causes.laws import LawCause
from tissuereg.experiment.effects import Asymmetry, Effect

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

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the exponent's distance from the neo-Hookean one, or the logarithm of the stiffness in tension."""
        form, law = str(variant.settings["volumetric"]), str(variant.settings["law"])
        start = float(variant.settings["size"]) * min(max(float(amplitudes[0]), 0.1), 2.0)
        if law == "ogden":
            return knobs(
                [(start, 0.0, 12.0, 0.5)],
                lambda x, young: (self.effect(law, float(x[0]), form),),
                lambda x, young: {"law": law, "alpha": [EVEN + float(x[0])], "volumetric": form},
            )
        return knobs(
            [(float(np.log1p(start)), 0.0, 0.7, 0.05)],
            lambda x, young: (self.effect(law, float(np.expm1(x[0])), form),),
            lambda x, young: {"law": law, main_key(law): float(np.expm1(x[0])), "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same exponent with the other volumetric forms; a bimodular law has one form."""
        return () if variant.settings["law"] == "bimodular" else super().alternatives(bench, variant)

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        if values["law"] == "bimodular":
            factor = 1.0 + values[main_key("bimodular")]
            return f"Stretched directions of the body have {factor:.3g} times the stiffness of compressed ones."
        exponent = values["alpha"][0]
        side = "compression" if exponent < 0 else "tension"
        return f"The body is stiffer in {side} than the believed law (Ogden's exponent {exponent:.3g})."
