"""The body's own weight: where it points, how strong it is, whether the mesh already hangs in it."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tissuereg._base.fields import flag, number, numbers
from tissuereg.experiment.effects.base import Effect, Vector, refuse
from tissuereg.experiment.experiment import BodyWeight as Weight
from tissuereg.experiment.experiment import Experiment


@dataclass(frozen=True, kw_only=True)
class _Weight(Effect):
    """Changes of ``[gravity]``; a key that is left out keeps what is believed."""

    absolute: ClassVar[bool] = True
    direction: Vector | None = numbers("where the weight points", 3, directed=True, default=None)
    g_mm_per_s2: float | None = number("acceleration", above=0.0, default=None)
    in_reference: bool | None = flag("whether the mesh already hangs in it", default=None)

    def check(self) -> None:
        """Refuse a table without keys."""
        if self.direction is None and self.g_mm_per_s2 is None and self.in_reference is None:
            refuse("one of `direction`, `g_mm_per_s2`, `in_reference` must be given")

    def fits(self, experiment: Experiment) -> None:
        """Refuse a weight without direction."""
        if experiment.gravity is None and self.direction is None:
            refuse("`direction` must be given where the experiment has no [gravity]")

    def applied(self, experiment: Experiment, element: str) -> Experiment:
        """Return the experiment with this weight."""
        weight = experiment.gravity or Weight(np.asarray(self.direction), in_reference=False)
        if self.direction is not None:
            weight = replace(weight, direction=np.asarray(self.direction))
        if self.g_mm_per_s2 is not None:
            weight = replace(weight, g_mm_per_s2=self.g_mm_per_s2)
        if self.in_reference is not None:
            weight = replace(weight, in_reference=self.in_reference)
        return replace(experiment, gravity=weight)


@dataclass(frozen=True, kw_only=True)
class Gravity(_Weight):
    """A weight other than the believed one: tilted, stronger or weaker, or present where none is believed."""

    id: ClassVar[str] = "gravity"


@dataclass(frozen=True, kw_only=True)
class Reference(_Weight):
    """Another reference shape: whether the mesh already hangs in gravity."""

    id: ClassVar[str] = "reference"
    in_reference: bool | None = flag("whether the mesh already hangs in it")
