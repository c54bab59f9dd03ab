"""Reference shape: whether the mesh is the body deformed by gravity, or the unloaded body."""

from collections.abc import Iterable

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Reference


class ReferenceCause(Cause, id="reference", family="rest", absolute=True):
    """Whether the mesh is already deformed by the believed gravity."""

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, the opposite of what is believed; none where no gravity is believed."""
        weight = bench.experiment.gravity
        if weight is None:
            return
        hangs = not weight.in_reference
        changed = bench.change(Reference(in_reference=hangs))
        if changed is not None:
            yield Variant("hangs" if hangs else "does not hang", changed[None], {"hangs": hangs}, fixed=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return no free parameters (k = 0): the effect is the opposite of what is believed about the mesh."""
        opposite = Reference(in_reference=bool(variant.settings["hangs"]))
        return free_parameters([], lambda x, young: (opposite,))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `in_reference` (a bool)."""
        how = "is already deformed by gravity" if values["in_reference"] else "is the shape without gravity"
        return f"The mesh {how}, contrary to what is believed."
