"""Causes that put another law in the place of a believed neo-Hookean one.

The believed law is the coupled neo-Hookean one. Coupled laws differ from it by their shape alone; split ones also by
the split, which looks like another Poisson's ratio. The bank holds the nested form, the fit tries the split one too.
"""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Variant
from tissuereg.effects import Effect


class LawCause(Cause):
    """Laws that are the believed one where their shape vanishes; secants are taken at one or more sizes of each."""

    discrete: ClassVar[tuple[str, ...]] = ("law",)

    #: Laws and sizes of their shape where secants are taken.
    tried: ClassVar[tuple[tuple[str, float], ...]]

    @abstractmethod
    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a law of some shape in a form, as `Material.volumetric` has it."""

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return secants to all laws in the nested form; none where another law is believed."""
        for form in _forms(bench)[:1]:
            changes = bench.changes([[self.effect(law, size, form)] for law, size in self.tried])
            for (law, size), changed in zip(self.tried, changes, strict=True):
                if changed is not None:
                    settings = {"law": law, "size": size, "volumetric": form}
                    yield Variant(f"{law} {size:g}", changed[None], settings, positive=True)

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the same shape in the other forms."""
        return tuple(replace(variant, settings={**variant.settings, "volumetric": form}) for form in _forms(bench)[1:])


def _forms(bench: Bench) -> tuple[str, ...]:
    """Return how other laws may treat the volume, the nested form first; none where none is tried."""
    material = bench.experiment.material
    if material.law != "neo-hookean":
        return ()
    return ("quadratic",) if material.volumetric == "quadratic" else ("coupled", "log")
