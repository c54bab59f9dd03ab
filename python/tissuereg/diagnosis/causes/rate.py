"""Viscosity: a stress proportional to the rate of strain."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Rate

#: Viscosity over modulus and the time between frames at which the change is simulated.
SIZE = 0.2


class RateCause(Cause):
    """A viscous stress in addition to the elastic one."""

    id: ClassVar[str] = "rate"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis.

        `bench`: the believed model and its sensitivities. Columns of a hypothesis are (p, size), in mm and mN.
        """
        if bench.longest_case == 0.0 or any(effect.id == self.id for effect in bench.experiment.effects):
            return
        changed = bench.change(Rate(viscosity_kpa_s=SIZE * bench.frame_step * bench.young))
        if changed is not None:
            yield Variant("viscosity", changed[None], positive=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logarithm of viscosity over modulus.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        unit = SIZE * bench.frame_step
        return free_parameters(
            [(float(np.log(unit * np.clip(amplitudes[0], 0.05, 20.0))), float(np.log(unit)), 1.5, 0.05)],
            lambda x, young: (Rate(viscosity_kpa_s=float(np.exp(x[0])) * young),),
            lambda x, young: {"viscosity_kpa_s": float(np.exp(x[0])) * young},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        return f"The body resists fast motion: a viscosity of {values['viscosity_kpa_s']:.2g} kPa s."
