"""Moduli: the whole body is stiffer or softer (Young), or more or less compressible (Poisson), than believed."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import inner_share, logistic, logit
from tissuereg.experiment.effects import Poisson, Stiffness
from tissuereg.simulation.sensitivity import Parameter


@dataclass(frozen=True)
class StiffnessCause(Cause, id="stiffness", family="law", absolute=True):
    """Another Young's modulus; every fit has it as a nuisance, a finding is named where it lies far from its prior."""

    #: Prior deviation of the logarithm of the factor on the modulus, in addition to that of the believed modulus.
    spread: float = 1.0

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: another modulus in the whole body; none for a body with memory."""
        return [Variant("everywhere", self.spread * bench.by_young)] if bench.is_elastic else []

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logarithm of a factor on Young's modulus."""
        factor = (self.spread * float(amplitudes[0]), 0.0, self.spread, 0.02)
        return free_parameters([factor], lambda x, young: (Stiffness(young_kpa=young * float(np.exp(x[0]))),))

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form without parameters of its own: the modulus is the first one of every fit."""
        return [replace(free_parameters([], lambda x, young: (Stiffness(young_kpa=young),)), label="young")]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted modulus `young_kpa`."""
        return f"The modulus at small strain is {values['young_kpa']:.3g} kPa, far from the believed one."


@dataclass(frozen=True)
class PoissonCause(Cause, id="poisson", family="law"):
    """Poisson's ratio."""

    #: Prior deviation of the ratio.
    spread: float = 0.06

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis: another Poisson's ratio in the whole body; none if its simulation fails."""
        if bench.is_elastic:
            column = bench.by(lambda state: [Parameter("poisson")], 1)
        else:
            changed = bench.change(Poisson(poisson=_ratio(bench) - 0.02))
            if changed is None:
                return []
            column = -changed[None] / 0.02
        return [Variant("everywhere", self.spread * column)]

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logit of twice Poisson's ratio."""
        believed = _ratio(bench)
        start = min(max(believed + self.spread * float(amplitudes[0]), 0.05), 0.495)
        ratio = (logit(2.0 * start, 0.005), logit(2.0 * believed, 0.005), 1.5, 0.05)
        return free_parameters([ratio], lambda x, young: (Poisson(poisson=0.5 * logistic(x[0])),))

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form: the logit of twice the ratio; none without shear and bars."""
        # A bar determines E, shear determines E / (1 + nu).
        if "simple-shear" not in scene.modes or len(scene.modes) < 2:
            return []
        believed = min(max(2.0 * scene.poisson, 0.02), 0.999)
        mean = logit(believed, 0.001)

        def effect(x: FloatArray) -> Poisson:
            return Poisson(poisson=0.5 * inner_share(min(float(x[0]), 8.0)))

        return [curve_form("poisson", [(mean, 1.5)], effect, [(mean - 1.5,), (mean + 1.0,)])]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted ratio `poisson`."""
        return f"The compressibility differs from the believed one: Poisson's ratio is {values['poisson']:.3f}."


def _ratio(bench: Bench) -> float:
    return float(bench.experiment.material.poisson_array.mean())
