"""Pull and push are no mirror images."""

from collections.abc import Iterable
from typing import ClassVar

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs
from tissuereg.effects import Asymmetry, Effect

#: Exponent of Ogden's law that equals a neo-Hookean one, and distances from it at which secants are taken.
EVEN = 2.0
DISTANCES = (-12.0, 10.0)


class AsymmetryCause(Cause):
    """Ogden's law of one term: stiffer in compression for negative exponents, in tension for large positive ones."""

    id: ClassVar[str] = "asymmetry"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return secants to both sides."""
        if bench.experiment.material.law != "neo-hookean":
            return
        changes = bench.changes([[_effect(EVEN + distance)] for distance in DISTANCES])
        for distance, changed in zip(DISTANCES, changes, strict=True):
            if changed is not None:
                yield Variant(f"alpha {EVEN + distance:g}", changed[None], {"distance": distance}, positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the exponent."""
        start = EVEN + float(variant.settings["distance"]) * min(max(float(amplitudes[0]), 0.1), 2.5)
        return knobs(
            [(start, EVEN, 12.0, 0.5)],
            lambda x, young: (_effect(float(x[0])),),
            lambda x, young: {"alpha": [float(x[0])]},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        alpha = values["alpha"]
        exponent = alpha[0]
        side = "compression" if exponent < 0 else "tension"
        return f"The body is stiffer in {side} than its mirror image (Ogden's exponent {exponent:.3g})."


def _effect(exponent: float) -> Effect:
    if abs(exponent) < 0.1:
        exponent = 0.1 if exponent >= 0 else -0.1
    return Asymmetry(law="ogden", alpha=(exponent,), weight=(1.0,))
