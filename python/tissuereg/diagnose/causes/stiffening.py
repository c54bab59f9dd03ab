"""The body stiffens with strain."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs
from tissuereg.diagnose.causes.laws import form_of, forms_of_laws, other_forms
from tissuereg.effects import Effect, Stiffening

#: Where secants are taken: exponents of Fung's law, a ratio of Yeoh's. Skin has exponents of some tens.
EXPONENTS = (1.0, 4.0, 16.0)
RATIO = 2.0

#: Largest logarithm of a shape parameter: a strain of 0.1 then multiplies the modulus by some thousands.
LARGEST = 7.0


class StiffeningCause(Cause):
    """Fung's exponential law or Yeoh's polynomial in place of one without stiffening."""

    id: ClassVar[str] = "stiffening"
    discrete: ClassVar[tuple[str, ...]] = ("law",)

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return secants to both laws."""
        for form in forms_of_laws(bench)[:1]:
            yield from self._secants(bench, form)

    def _secants(self, bench: Bench, form: str) -> Iterable[Variant]:
        tried: list[tuple[str, float]] = [("fung", b) for b in EXPONENTS] + [("yeoh", RATIO)]
        changes = bench.changes([[_effect(law, size, form)] for law, size in tried])
        for (law, size), changed in zip(tried, changes, strict=True):
            if changed is not None:
                yield Variant(f"{law} {size:g}", changed[None], {"law": law, "size": size}, positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logarithm of the law's shape parameter."""
        law, size = str(variant.settings["law"]), float(variant.settings["size"])
        form = form_of(bench, variant.settings)
        start = float(np.log(size * np.clip(amplitudes[0], 0.1, 3.0)))
        return knobs(
            [(start, float(np.log(2.0)), 1.2, 0.05)],
            lambda x, young: (_effect(law, float(np.exp(min(x[0], LARGEST))), form),),
            lambda x, young: {"law": law, _KEY[law]: float(np.exp(min(x[0], LARGEST))), "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same law in the split form."""
        return other_forms(bench, variant)

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        key = "b" if "b" in values else "c2_over_c1"
        return f"The body stiffens with strain ({key} = {values[key]:.3g}): large pushes meet more than is believed."


_KEY = {"fung": "b", "yeoh": "c2_over_c1"}


def _effect(law: str, size: float, form: str) -> Effect:
    if law == "fung":
        return Stiffening(law="fung", b=size, volumetric=form)
    return Stiffening(law="yeoh", c2_over_c1=size, c3_over_c1=0.0, volumetric=form)
