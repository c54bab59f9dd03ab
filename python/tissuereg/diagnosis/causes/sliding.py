"""Sliding of a support, on tangential springs or with friction."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Sliding


@dataclass(frozen=True)
class SlidingCause(Cause, id="sliding", family="support", discrete=("boundary", "kind"), constant=False):
    """A boundary on tangential springs, or one that slips where the tangential stress exceeds friction."""

    #: Compliances of springs, times modulus over extent, at which changes are simulated.
    compliances: tuple[float, ...] = (0.03, 0.3)
    #: Coefficient of friction, and cohesions over the modulus, at which changes are simulated.
    coefficient: float = 0.3
    cohesions: tuple[float, ...] = (0.03, 0.1)

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return four hypotheses for each support that is not believed to slide: two of springs, two of friction."""
        taken = {getattr(effect, "boundary", None) for effect in bench.experiment.effects if effect.id == self.id}
        for boundary in bench.experiment.boundaries:
            name = boundary.name
            if name in taken or not len(Sliding(boundary=name, spring_kpa_per_mm=1.0).triangles(bench.experiment)):
                continue
            own = [("springs", size, _springs(bench, name, size, bench.young)) for size in self.compliances]
            own += [("friction", c, _friction(name, self.coefficient, c * bench.young)) for c in self.cohesions]
            tried = [
                (f"{name} {kind} {size:g}", effect, {"boundary": name, "kind": kind, "size": size})
                for kind, size, effect in own
            ]
            yield from self.simulated(bench, tried)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logarithm of the compliance of springs, or the logarithms of friction coefficient and cohesion.

        The compliance is Young's modulus over spring stiffness and extent of the body, the cohesion over the modulus.
        """
        name, size = str(variant.settings["boundary"]), float(variant.settings["size"])
        more = float(np.clip(amplitudes[0], 0.1, 10.0))
        if variant.settings["kind"] == "springs":
            return free_parameters(
                [(np.log(size * more), np.log(0.1), 1.5, 0.1)],
                lambda x, young: (_springs(bench, name, float(np.exp(x[0])), young),),
            )
        # A smaller cohesion slips more.
        cohesion, likely = size / np.sqrt(more), np.log(self.coefficient)
        return free_parameters(
            [(likely, likely, 0.7, 0.1), (np.log(cohesion), np.log(0.05), 1.0, 0.1)],
            lambda x, young: (_friction(name, float(np.exp(x[0])), float(np.exp(x[1])) * young),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted springs or friction of a `boundary`."""
        name = f"Boundary '{values['boundary']}'"
        if "friction" in values:
            friction = f"coefficient {values['friction']:.2g}, cohesion {values['cohesion_kpa']:.2g} kPa"
            return f"{name} slips against friction ({friction})."
        return f"{name} slides, as if on springs of {values['spring_kpa_per_mm']:.2g} kPa/mm."


def _springs(bench: Bench, boundary: str, compliance: float, young: float) -> Sliding:
    return Sliding(boundary=boundary, spring_kpa_per_mm=young / (compliance * bench.extent))


def _friction(boundary: str, coefficient: float, cohesion: float) -> Sliding:
    return Sliding(boundary=boundary, friction=coefficient, cohesion_kpa=cohesion)
