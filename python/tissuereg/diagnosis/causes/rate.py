"""Viscosity: a stress proportional to the rate of strain."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import exponential
from tissuereg.experiment.effects import Rate


@dataclass(frozen=True)
class RateCause(Cause, id="rate", family="memory"):
    """A viscous stress in addition to the elastic one."""

    #: Viscosity over modulus and the time between frames at which the change is simulated.
    size: float = 0.2

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: a fixed viscosity; none where no time passes, or where a viscosity is believed."""
        if bench.longest_case == 0.0 or self.believed(bench):
            return []
        effect = Rate(viscosity_kpa_s=self.size * bench.frame_step * bench.young)
        return self.simulated(bench, [("viscosity", effect, {})])

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logarithm of the viscosity over Young's modulus, in s."""
        unit = self.size * bench.frame_step
        time = (np.log(unit * np.clip(amplitudes[0], 0.05, 20.0)), np.log(unit), 1.5, 0.05)
        return free_parameters([time], lambda x, young: (Rate(viscosity_kpa_s=float(np.exp(x[0])) * young),))

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form: the logarithm of the viscosity in kPa s; none where curves cannot show effects of time."""
        if not (scene.paced and scene.fastest > 0):
            return []
        likely = float(np.log(0.1 * scene.peak / (3.0 * scene.fastest)))
        return [curve_form("viscosity", [(likely, 2.0)], lambda x: Rate(viscosity_kpa_s=exponential(float(x[0]))))]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `viscosity_kpa_s`."""
        return f"The stress grows with the rate of strain: a viscosity of {values['viscosity_kpa_s']:.2g} kPa s."
