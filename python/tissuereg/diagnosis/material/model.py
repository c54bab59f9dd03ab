"""The model of a material test: an elastic law with optional effects of time and history."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

from tissuereg import _core
from tissuereg.body.material import Material
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.history import Memory
from tissuereg.simulation.memory import behaviour_of


@dataclass(frozen=True, eq=False)
class Model:
    """A material model: an elastic law, with optional effects of time and load history (its memory).

    `material`: law, instantaneous moduli and fibres; `memory`: each effect of time and load history, by its id.
    """

    material: Material
    memory: Mapping[str, Memory] = field(default_factory=dict)

    @property
    def remembers(self) -> bool:
        """Whether the stress depends on the history of the strain, not on the present strain alone."""
        return bool(self.memory)

    @property
    def behaviour(self) -> _core.Behaviour | None:
        """The memory as the solver takes it; None if there is none."""
        behaviour = behaviour_of(self.memory.values())
        return None if behaviour is None else behaviour.core()

    def with_young(self, young: float) -> "Model":
        """Return the model with another Young's modulus, kPa."""
        return replace(self, material=replace(self.material, young=young))

    def with_effects(self, effects: Iterable[Effect]) -> "Model":
        """Return the model with effects on moduli, law, fibres or memory applied; others raise `ExperimentError`."""
        model = self
        for effect in effects:
            if not effect.of_specimen:
                message = f"an effect of a material test must be one on the material, got '{effect.id}'"
                raise ExperimentError(message, where=effect.id)
            if isinstance(effect, Memory):
                model = replace(model, memory={**model.memory, effect.id: effect})
            else:
                # Others change the field `material` alone, of an experiment as of this record.
                model = cast("Model", effect.applied(cast("Any", model), "tet4"))
        return model
