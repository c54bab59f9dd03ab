"""Swelling: the body grows or shrinks during the measurement."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Effect, Swelling

#: Behaviour of pads in the hypotheses of the bank: they hold their patches against the growth.
HOLD = "hold"


@dataclass(frozen=True)
class SwellingCause(Cause, id="swelling", family="memory", discrete=("window", "pads")):
    """Growth of all lengths at a constant rate, over the whole session or a half of it."""

    #: Linear strain at which changes are simulated, the prior deviation in screening.
    size: float = 0.01

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return hypotheses for the whole session and each half; none where no time passes or swelling is believed."""
        begin, end = bench.first_time, bench.last_time
        if end <= begin or self.believed(bench):
            return
        middle = 0.5 * (begin + end)
        windows = ((begin, end), (begin, middle), (middle, end))
        changes = bench.changes([[_effect(self.size, window, HOLD)] for window in windows])
        for window, changed in zip(windows, changes, strict=True):
            if changed is not None:
                yield Variant(f"{window[0]:.3g} to {window[1]:.3g} s", changed[None], {"window": window, "pads": HOLD})

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the hypothesis of the same growth with pads that move with the body; none where no pad is moved."""
        moved = any(case.displacements for case in bench.experiment.cases.values())
        return (replace(variant, settings={**variant.settings, "pads": "follow"}),) if moved else ()

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the linear strain at the end of the window, in units of `size` (0.01)."""
        window, pads = variant.settings["window"], str(variant.settings["pads"])
        strain = (float(amplitudes[0]), 0.0, 1.5, 0.1)
        return free_parameters([strain], lambda x, young: (_effect(self.size * float(x[0]), window, pads),))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `linear_strain` (dimensionless)."""
        verb, percent = "swells" if values["linear_strain"] > 0 else "shrinks", abs(100 * values["linear_strain"])
        return f"The body {verb} by {percent:.2g} % in length during the measurement."


def _effect(strain: float, window: tuple[float, float], pads: str) -> Effect:
    return Swelling(linear_strain=strain, from_time_s=window[0], to_time_s=window[1], pads=pads)
