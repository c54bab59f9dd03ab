"""Drainage: fluid leaves the body under load, so that a share of the volumetric stress relaxes."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import logistic, logit
from tissuereg.diagnosis.causes.relaxation import times_of
from tissuereg.experiment.effects import Drainage


@dataclass(frozen=True)
class DrainageCause(Cause, id="drainage", family="memory"):
    """A share of the volumetric stress relaxes with one time constant."""

    #: Share of the volumetric stress at which changes are simulated.
    share: float = 0.5
    #: Number of time constants, from the time between frames to twice the longest case.
    times: int = 6

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each of three time constants; none where no time passes or drainage is believed."""
        if bench.longest_case == 0.0 or self.believed(bench):
            return []
        tried = ((tau, Drainage(share=self.share, tau_s=float(tau))) for tau in times_of(bench, self.times)[1::2])
        return self.simulated(bench, ((f"{tau:.2g} s", effect, {"tau": tau}) for tau, effect in tried))

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: logit of the share that relaxes, and logarithm of the time constant in s."""
        tau, middle = float(variant.settings["tau"]), float(np.log(times_of(bench, self.times)).mean())
        return free_parameters(
            [(logit(self.share * float(amplitudes[0])), 0.0, 1.2, 0.1), (float(np.log(tau)), middle, 1.5, 0.1)],
            lambda x, young: (Drainage(share=logistic(x[0]), tau_s=float(np.exp(x[1]))),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `share` and time constant `tau_s` (s)."""
        share = f"{100 * values['share']:.0f} % of its pressure"
        return f"The body loses volume under load: {share} relaxes with a time constant of {values['tau_s']:.2g} s."
