"""The model of a material test: an elastic law with optional effects of time and history."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from tissuereg.body.material import Fibre as Fibres
from tissuereg.body.material import Material
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import Fibre, OtherLaw, Poisson, Stiffness
from tissuereg.experiment.effects.history import Rate, Relaxation, Set, Softening
from tissuereg.experiment.material_experiment import MaterialExperiment


@dataclass(frozen=True, eq=False)
class Model:
    """A material model: an elastic law, with optional effects of time and load history (its memory).

    Parameters
    ----------
    material : Material
        Law, instantaneous moduli and fibres.
    relaxation, rate, softening, set : effects of these names, optional
        Effects of time and history; None where the model has none: stress relaxation, viscosity, softening by the
        largest energy so far, permanent set.
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

    def with_material(self, **changes: Any) -> "Model":
        """Return the model with other values of some fields of its material.

        Parameters
        ----------
        **changes
            Fields of `Material` by name, for instance ``young=3.0`` (kPa).

        Returns
        -------
        Model
            The model with everything else unchanged.
        """
        return replace(self, material=replace(self.material, **changes))

    def with_effect(self, effect: Effect) -> "Model":
        """Return the model with one effect applied.

        Parameters
        ----------
        effect : Effect
            Change of moduli, law, fibres or memory.

        Returns
        -------
        Model
            The model with everything else unchanged.

        Raises
        ------
        ExperimentError
            If the effect does not act on the material.
        """
        match effect:
            case Stiffness():
                return self.with_material(young=effect.young_kpa)
            case Poisson():
                return self.with_material(poisson=effect.poisson)
            case OtherLaw():
                return replace(self, material=effect.of(self.material))
            case Fibre():
                return self.with_material(
                    fibre=Fibres(effect.k1_over_mu, effect.k2, effect.direction, effect.tension_only)
                )
            case Relaxation():
                return replace(self, relaxation=effect)
            case Rate():
                return replace(self, rate=effect)
            case Softening():
                return replace(self, softening=effect)
            case Set():
                return replace(self, set=effect)
        message = f"an effect of a material test must be one on the material, got '{effect.id}'"
        raise ExperimentError(message, where=effect.id)


def model_of(experiment: MaterialExperiment, effects: Iterable[Effect] | None = None) -> Model:
    """Return the model of an experiment: its believed material with effects applied.

    `experiment`: believed material and effects; `effects`: effects to apply in place of the experiment's own.
    """
    model = Model(experiment.material)
    for effect in experiment.effects if effects is None else effects:
        model = model.with_effect(effect)
    return model
