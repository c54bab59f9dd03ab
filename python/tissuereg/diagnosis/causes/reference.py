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
    absolute: ClassVar[bool] = True

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the opposite of what is believed; none without gravity.

        `bench`: the believed model and its sensitivities. Columns of a hypothesis are (p, size), in mm and mN.
        """
        weight = bench.experiment.gravity
        if weight is None:
            return
        hangs = not weight.in_reference
        changed = bench.change(Reference(in_reference=hangs))
        if changed is not None:
            yield Variant("hangs" if hangs else "does not hang", changed[None], {"hangs": hangs}, fixed=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return no parameters.

        `bench`: the believed model; `variant`: hypothesis from which the nonlinear fit starts; `amplitudes` (p,): its
        fitted linear amplitudes, in prior standard deviations.
        """
        hangs, none = bool(variant.settings["hangs"]), np.empty(0)
        return FreeParameters(
            none, none, none,
            lambda x, young: (Reference(in_reference=hangs),),
            lambda x, young: {"in_reference": hangs},
            none,
        )  # fmt: skip

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence, from its fitted parameters (`values`, by key of ``[[effect]]``)."""
        how = "is already deformed by gravity" if values["in_reference"] else "is the shape without gravity"
        return f"The mesh {how}, contrary to what is believed."
