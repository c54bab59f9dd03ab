"""The second invariant has a share of the energy."""

from collections.abc import Iterable
from typing import ClassVar

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs, logistic, logit
from tissuereg.effects import Mooney


class MooneyCause(Cause):
    """Mooney and Rivlin's law."""

    id: ClassVar[str] = "mooney"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the secant to a share of one half."""
        if bench.experiment.material.law != "neo-hookean":
            return
        changed = bench.change(Mooney(law="mooney-rivlin", share=0.5))
        if changed is not None:
            yield Variant("share", changed[None], positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logit of the share."""
        return knobs(
            [(logit(0.5 * float(amplitudes[0])), 0.0, 1.5, 0.1)],
            lambda x, young: (Mooney(law="mooney-rivlin", share=logistic(x[0])),),
            lambda x, young: {"share": logistic(x[0])},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        return f"A share of {values['share']:.2g} of the energy follows the second invariant (Mooney-Rivlin)."
