"""Permanent set: a share of the largest strain remains after unloading."""

from collections.abc import Iterable
from typing import ClassVar

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters, logistic, logit
from tissuereg.experiment.effects import Set

#: Share at which the change is simulated.
SIZE = 0.1


class SetCause(Cause):
    """Permanent set."""

    id: ClassVar[str] = "set"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis.

        `bench`: the believed model and its sensitivities. Columns of a hypothesis are (p, size), in mm and mN.
        """
        if any(effect.id == self.id for effect in bench.experiment.effects):
            return
        changed = bench.change(Set(fraction=SIZE))
        if changed is not None:
            yield Variant("share", changed[None], positive=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logit of the share.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        return free_parameters(
            [(logit(SIZE * float(amplitudes[0]), 0.005), logit(SIZE), 1.2, 0.1)],
            lambda x, young: (Set(fraction=logistic(x[0])),),
            lambda x, young: {"fraction": logistic(x[0])},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        share = values["fraction"]
        return f"The body does not return to its shape: {100 * share:.1f} % of its largest strain remains."
