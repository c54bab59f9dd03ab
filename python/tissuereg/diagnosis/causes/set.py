"""Permanent set: a share of the largest strain remains after unloading."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import inner_share, logistic, logit
from tissuereg.experiment.effects import Set


@dataclass(frozen=True)
class SetCause(Cause, id="set", family="memory"):
    """Permanent set."""

    #: Share at which the change is simulated.
    size: float = 0.1

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: a fixed share of the largest strain remains; none where a set is already believed."""
        return [] if self.believed(bench) else self.simulated(bench, [("share", Set(fraction=self.size), {})])

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logit of the share of the largest strain that remains."""
        start = logit(self.size * float(amplitudes[0]), 0.005)
        return free_parameters([(start, logit(self.size), 1.2, 0.1)], lambda x, young: (Set(fraction=logistic(x[0])),))

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form: the logit of the share of the largest strain that remains; none without unloading."""
        form = curve_form("set", [(-2.5, 1.2)], lambda x: Set(fraction=inner_share(float(x[0]))))
        return [form] if scene.unloaded else []

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `fraction` of the strain that remains."""
        return f"A share of {100 * values['fraction']:.1f} % of the largest strain so far remains after unloading."
