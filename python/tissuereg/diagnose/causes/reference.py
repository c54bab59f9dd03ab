"""The reference shape is another one: the mesh hangs in gravity already, or does not."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant
from tissuereg.effects import Reference


class ReferenceCause(Cause):
    """Whether the mesh hangs in the believed gravity already."""

    id: ClassVar[str] = "reference"
    absolute: ClassVar[bool] = True

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the other answer; none without gravity."""
        weight = bench.experiment.gravity
        if weight is None:
            return
        hangs = not weight.in_reference
        changed = bench.change(Reference(in_reference=hangs))
        if changed is not None:
            yield Variant("hangs" if hangs else "does not hang", changed[None], {"hangs": hangs}, fixed=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return none: there is nothing to turn."""
        hangs, none = bool(variant.settings["hangs"]), np.empty(0)
        return Knobs(
            none, none, none,
            lambda x, young: (Reference(in_reference=hangs),),
            lambda x, young: {"in_reference": hangs},
            none,
        )  # fmt: skip

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        how = "hangs in gravity already" if values["in_reference"] else "was made without gravity"
        return f"The mesh {how}, against what is believed."
