"""The second invariant has a share of the energy."""

from collections.abc import Iterable
from typing import ClassVar

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs, logistic, logit
from tissuereg.diagnose.causes.laws import form_of, forms_of_laws, other_forms
from tissuereg.effects import Mooney


class MooneyCause(Cause):
    """Mooney and Rivlin's law."""

    id: ClassVar[str] = "mooney"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the secant to a share of one half."""
        for form in forms_of_laws(bench)[:1]:
            changed = bench.change(_effect(0.5, form))
            if changed is not None:
                yield Variant("share", changed[None], positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logit of the share."""
        form = form_of(bench, variant.settings)
        return knobs(
            [(logit(0.5 * float(amplitudes[0])), 0.0, 1.5, 0.1)],
            lambda x, young: (_effect(logistic(x[0]), form),),
            lambda x, young: {"law": "mooney-rivlin", "share": logistic(x[0]), "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same share in the split form."""
        return other_forms(bench, variant)

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        return f"A share of {values['share']:.2g} of the energy follows the second invariant (Mooney-Rivlin)."


def _effect(share: float, form: str) -> Mooney:
    return Mooney(law="mooney-rivlin", share=share, volumetric=form)
