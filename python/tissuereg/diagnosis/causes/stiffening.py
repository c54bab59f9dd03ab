"""Strain stiffening: Fung's exponential law or Yeoh's polynomial law."""

from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Knobs, Values, Variant, knobs
from tissuereg.diagnosis.causes.laws import LawCause
from tissuereg.experiment.effects import Effect, Stiffening

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

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logarithm of the law's shape parameter."""
        law, size = str(variant.settings["law"]), float(variant.settings["size"])
        form = str(variant.settings["volumetric"])
        start = float(np.log(size * np.clip(amplitudes[0], 0.1, 3.0)))
        return knobs(
            [(start, float(np.log(2.0)), 1.2, 0.05)],
            lambda x, young: (self.effect(law, _shape(x), form),),
            lambda x, young: {"law": law, main_key(law): _shape(x), "volumetric": form},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        key = main_key(str(values["law"]))
        return f"The body stiffens with strain ({key} = {values[key]:.3g}): large pushes meet more than is believed."


def _shape(x: FloatArray) -> float:
    return float(np.exp(min(x[0], LARGEST)))
