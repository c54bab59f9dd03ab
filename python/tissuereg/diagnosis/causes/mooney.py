"""Mooney-Rivlin: a share of the energy depends on the second invariant."""

from typing import ClassVar

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Knobs, Values, Variant, knobs, logistic, logit
from tissuereg.diagnosis.causes.laws import LawCause
from tissuereg.experiment.effects import Effect, Mooney

LAW = "mooney-rivlin"


class MooneyCause(LawCause):
    """The Mooney-Rivlin law."""

    id: ClassVar[str] = "mooney"
    tried: ClassVar[tuple[tuple[str, float], ...]] = ((LAW, 0.5),)

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return the law with a share."""
        return Mooney(law=law, volumetric=form, **shape_of(law, size))

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logit of the share."""
        form = str(variant.settings["volumetric"])
        return knobs(
            [(logit(0.5 * float(amplitudes[0])), 0.0, 1.5, 0.1)],
            lambda x, young: (self.effect(LAW, logistic(x[0]), form),),
            lambda x, young: {"law": LAW, main_key(LAW): logistic(x[0]), "volumetric": form},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        return f"A share of {values[main_key(LAW)]:.2g} of the energy follows the second invariant (Mooney-Rivlin)."
