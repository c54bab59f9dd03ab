"""Strain stiffening: Fung's exponential law or Yeoh's polynomial law."""

from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Knobs, Values, Variant, knobs
from tissuereg.diagnose.causes.laws import LawCause
from tissuereg.effects import Effect, Stiffening

#: Exponents of Fung's law, and ratio of Yeoh's, at which changes are simulated. Skin has exponents of some tens.
EXPONENTS = (1.0, 4.0, 16.0)
RATIO = 2.0

#: Largest logarithm of a shape parameter; a strain of 0.1 then multiplies the modulus by some thousands.
LARGEST = 7.0


class StiffeningCause(LawCause):
    """Fung's exponential law or Yeoh's polynomial law in place of the neo-Hookean one."""

    id: ClassVar[str] = "stiffening"
    tried: ClassVar[tuple[tuple[str, float], ...]] = (*(("fung", b) for b in EXPONENTS), ("yeoh", RATIO))

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return one of the two laws with an exponent or a ratio."""
        if law == "fung":
            return Stiffening(law="fung", b=size, volumetric=form)
        return Stiffening(law="yeoh", c2_over_c1=size, c3_over_c1=0.0, volumetric=form)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logarithm of the law's shape parameter."""
        law, size = str(variant.settings["law"]), float(variant.settings["size"])
        form = str(variant.settings["volumetric"])
        start = float(np.log(size * np.clip(amplitudes[0], 0.1, 3.0)))
        return knobs(
            [(start, float(np.log(2.0)), 1.2, 0.05)],
            lambda x, young: (self.effect(law, _shape(x), form),),
            lambda x, young: {"law": law, _KEY[law]: _shape(x), "volumetric": form},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in words."""
        key = "b" if "b" in values else "c2_over_c1"
        return f"The body stiffens with strain ({key} = {values[key]:.3g}), more than the believed law."


_KEY = {"fung": "b", "yeoh": "c2_over_c1"}


def _shape(x: FloatArray) -> float:
    return float(np.exp(min(x[0], LARGEST)))
