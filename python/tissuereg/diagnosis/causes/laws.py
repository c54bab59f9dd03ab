"""Base class of causes that replace a believed neo-Hookean law by another one.

The believed neo-Hookean law is coupled: its energy is not split into isochoric and volumetric parts. A coupled law of
another kind contains it as a special case of the shape parameter (it is nested); a split law also changes the
volumetric response, similar to another Poisson's ratio. The bank holds the nested form, the fit tries the split one
too.
"""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, Variant
from tissuereg.experiment.effects import Effect


class LawCause(Cause):
    """Laws that contain the believed one at a shape parameter of zero; changes are simulated at one or more values."""

    discrete: ClassVar[tuple[str, ...]] = ("law",)

    #: Laws and values of the shape parameter at which changes are simulated.
    tried: ClassVar[tuple[tuple[str, float], ...]]

    @abstractmethod
    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a law with a shape parameter, in a form of `Material.volumetric`."""

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return hypotheses for all laws in the nested form; none where the believed law is not neo-Hookean."""
        for form in _forms(bench)[:1]:
            changes = bench.changes([[self.effect(law, size, form)] for law, size in self.tried])
            for (law, size), changed in zip(self.tried, changes, strict=True):
                if changed is not None:
                    settings = {"law": law, "size": size, "volumetric": form}
                    yield Variant(f"{law} {size:g}", changed[None], settings, positive=True)

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same law in the other volumetric forms."""
        return tuple(replace(variant, settings={**variant.settings, "volumetric": form}) for form in _forms(bench)[1:])


def _forms(bench: Bench) -> tuple[str, ...]:
    """Return the volumetric forms of other laws, the nested one first; none where the law is not neo-Hookean."""
    material = bench.experiment.material
    if material.law != "neo-hookean":
        return ()
    return ("quadratic",) if material.volumetric == "quadratic" else ("coupled", "log")
