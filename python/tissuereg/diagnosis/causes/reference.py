"""Reference shape: whether the mesh is the body deformed by gravity, or the unloaded body."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant
from tissuereg.experiment.effects import Reference


class ReferenceCause(Cause):
    """Whether the mesh is already deformed by the believed gravity."""

    id: ClassVar[str] = "reference"
    family: ClassVar[str] = "rest"
    absolute: ClassVar[bool] = True

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, the opposite of what is believed; none where no gravity is believed.

        `bench`: the simulation as believed. Columns of a hypothesis, shape (1, size), are the change of all `size`
        measured numbers (markers in mm, forces in mN) by that opposite; its amplitude is exactly 1.
        """
        weight = bench.experiment.gravity
        if weight is None:
            return
        hangs = not weight.in_reference
        changed = bench.change(Reference(in_reference=hangs))
        if changed is not None:
            yield Variant("hangs" if hangs else "does not hang", changed[None], {"hangs": hangs}, fixed=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return no free parameters (k = 0): the effect is the opposite of what is believed about the mesh.

        `bench`: the simulation as believed; `variant`: the hypothesis; `amplitudes` (1,): not used. The result holds
        the functions that return the effect and the reported values.
        """
        hangs, none = bool(variant.settings["hangs"]), np.empty(0)
        return FreeParameters(
            none, none, none,
            lambda x, young: (Reference(in_reference=hangs),),
            lambda x, young: {"in_reference": hangs},
            none,
        )  # fmt: skip

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `in_reference` (a bool)."""
        how = "is already deformed by gravity" if values["in_reference"] else "is the shape without gravity"
        return f"The mesh {how}, contrary to what is believed."
