"""The model of a material test: an elastic law with optional effects of time and history."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, cast

from tissuereg.body.material import Material
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import Fibre, OtherLaw, Poisson, Stiffness
from tissuereg.experiment.effects.history import Rate, Relaxation, Set, Softening


@dataclass(frozen=True, eq=False)
class Model:
    """A material model: an elastic law, with optional effects of time and load history (its memory).

    `material`: law, instantaneous moduli and fibres; `relaxation`, `rate`, `softening`, `set`: the effects of these
    names (stress relaxation, viscosity, softening by the largest energy so far, permanent set); None without.
    """

    material: Material
    relaxation: Relaxation | None = None
    rate: Rate | None = None
    softening: Softening | None = None
    set: Set | None = None

    @property
    def remembers(self) -> bool:
        """Whether the stress depends on the history of the strain, not on the present strain alone."""
        return any(part is not None for part in (self.relaxation, self.rate, self.softening, self.set))

    def with_young(self, young: float) -> "Model":
        """Return the model with another Young's modulus, kPa."""
        return replace(self, material=replace(self.material, young=young))

    def with_effects(self, effects: Iterable[Effect]) -> "Model":
        """Return the model with effects on moduli, law, fibres or memory applied; others raise `ExperimentError`."""
        model = self
        for effect in effects:
            if isinstance(effect, Relaxation | Rate | Softening | Set):
                memory: dict[str, Any] = {effect.id: effect}
                model = replace(model, **memory)
            elif isinstance(effect, Stiffness | Poisson | OtherLaw | Fibre):
                # These change the field `material` alone, of an experiment as of this record.
                model = cast("Model", effect.applied(cast("Any", model), "tet4"))
            else:
                message = f"an effect of a material test must be one on the material, got '{effect.id}'"
                raise ExperimentError(message, where=effect.id)
        return model
