"""A support slides."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs
from tissuereg.effects import Sliding

#: Where secants are taken: compliance times modulus over extent.
COMPLIANCES = (0.03, 0.3)


class SlidingCause(Cause):
    """A boundary on tangential springs."""

    id: ClassVar[str] = "sliding"
    discrete: ClassVar[tuple[str, ...]] = ("boundary",)

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return two secants a boundary."""
        taken = {getattr(effect, "boundary", None) for effect in bench.experiment.effects if effect.id == self.id}
        for boundary in bench.experiment.boundaries:
            if boundary.name in taken or not len(_triangles(bench, boundary.name)):
                continue
            tried = [[_effect(bench, boundary.name, size, bench.young)] for size in COMPLIANCES]
            for size, changed in zip(COMPLIANCES, bench.changes(tried), strict=True):
                if changed is not None:
                    settings = {"boundary": boundary.name, "size": size}
                    yield Variant(f"{boundary.name} {size:g}", changed[None], settings, positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logarithm of the compliance."""
        name, size = str(variant.settings["boundary"]), float(variant.settings["size"])
        start = float(np.log(size * np.clip(amplitudes[0], 0.1, 10.0)))
        return knobs(
            [(start, float(np.log(0.1)), 1.5, 0.1)],
            lambda x, young: (_effect(bench, name, float(np.exp(x[0])), young),),
            lambda x, young: {
                "boundary": name,
                "spring_kpa_per_mm": young / (float(np.exp(x[0])) * bench.extent),
            },
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        return f"Boundary '{values['boundary']}' slides, as if on springs of {values['spring_kpa_per_mm']:.2g} kPa/mm."


def _triangles(bench: Bench, boundary: str) -> FloatArray:
    return np.asarray(Sliding(boundary=boundary, spring_kpa_per_mm=1.0).triangles(bench.experiment))


def _effect(bench: Bench, boundary: str, compliance: float, young: float) -> Sliding:
    return Sliding(boundary=boundary, spring_kpa_per_mm=young / (compliance * bench.extent))
