"""Young's modulus: the whole body is stiffer or softer than believed."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, Knobs, Values, Variant, knobs
from tissuereg.experiment.effects import Stiffness

#: Prior deviation of the logarithm of the factor on the modulus, in addition to that of the believed modulus.
SPREAD = 1.0


class StiffnessCause(Cause):
    """Young's modulus; a nuisance within its prior, a finding beyond it (`tissuereg.diagnosis.nuisances`)."""

    id: ClassVar[str] = "stiffness"
    absolute: ClassVar[bool] = True

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: another modulus in the whole body."""
        return [Variant("everywhere", SPREAD * bench.by_young)] if bench.is_elastic else []

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the logarithm of the factor on the modulus."""
        return knobs(
            [(SPREAD * float(amplitudes[0]), 0.0, SPREAD, 0.02)],
            lambda x, young: (Stiffness(young_kpa=young * float(np.exp(x[0]))),),
            lambda x, young: {"young_kpa": young * float(np.exp(x[0]))},
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in words."""
        return f"The body's modulus is {values['young_kpa']:.3g} kPa, far from the believed one."
