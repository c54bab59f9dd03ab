"""Other laws in the place of a believed neo-Hookean one, in the forms that the same moduli leave open."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Variant


def forms_of_laws(bench: Bench) -> tuple[str, ...]:
    """Return how other laws may treat the volume, as `Material.volumetric`; none where none is tried.

    The believed law is the coupled neo-Hookean one. Coupled laws differ from it by their shape alone; split ones also
    by the split, which looks like another Poisson's ratio.

    Parameters
    ----------
    bench : Bench
        The believed model.

    Returns
    -------
    tuple of str
        The nested form first.
    """
    material = bench.experiment.material
    if material.law != "neo-hookean":
        return ()
    return ("quadratic",) if material.volumetric == "quadratic" else ("coupled", "log")


def other_forms(bench: Bench, variant: Variant) -> tuple[Variant, ...]:
    """Return a hypothesis of a law in its other forms, with the columns of the nested one."""
    return tuple(
        replace(variant, settings={**variant.settings, "volumetric": form}) for form in forms_of_laws(bench)[1:]
    )


def form_of(bench: Bench, settings: Mapping[str, Any]) -> str:
    """Return the form of a hypothesis; the nested one where it names none."""
    return str(settings.get("volumetric") or forms_of_laws(bench)[0])
