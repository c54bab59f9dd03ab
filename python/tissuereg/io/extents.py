"""Whether the largest extent of a body fits its unit: refused where no organ is that large, told where few are."""

import numpy as np

from tissuereg._base.provenance import warn
from tissuereg.errors import UnitError, UnitWarning
from tissuereg.io.bounds import FILES

#: Millimetres in each unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

#: Their names in words.
UNIT_NAMES = {"mm": "millimetres", "cm": "centimetres", "m": "metres"}


def check_extent(extent: float, unit: str, place: str, advice: str, *, sure: bool = False) -> None:
    """Raise `UnitError` if a body's extent is not that of an organ, and warn (`UnitWarning`) if it is unlikely.

    `extent`: largest extent along an axis, in `unit` (a key of `UNITS_MM`); `place`: what has it, for the message;
    `advice`: what to do, with ``{unit}`` and ``{factor}`` where the unit that would make it a body belongs, and that in
    the present one; `sure`: whether the unit was stated, so that there is no warning.
    """
    size = extent * UNITS_MM[unit]
    if FILES.usual_least_mm <= size <= FILES.usual_most_mm:
        return
    possible = FILES.least_extent_mm <= size <= FILES.most_extent_mm
    likely = _likely_unit(extent)
    if likely is None:
        lead = f"neither of {', '.join(UNITS_MM)} makes this a body; convert the file"
    elif likely == unit:
        lead = "check its unit"
    else:
        factor = UNITS_MM[likely] / UNITS_MM[unit]
        lead = f"looks like {UNIT_NAMES[likely]}; {advice.format(unit=likely, factor=factor)}"
        inch_mm = 25.4
        if likely == "cm" and FILES.usual_least_mm <= extent * inch_mm <= FILES.usual_most_mm:
            lead += f", or if they are inches multiply them by {inch_mm:g}"
    if not possible:
        message = (
            f"extent {extent:.3g}: {lead}. The largest extent of a body must lie between {FILES.least_extent_mm:g} and "
            f"{FILES.most_extent_mm:g} mm; {place}, read in {unit}, has {size:.4g} mm"
        )
        raise UnitError(message, where=place.strip("`"))
    if not sure:
        text = (
            f"extent {extent:.3g}: {lead}. A body is rarely smaller than {FILES.usual_least_mm:g} or larger than "
            f"{FILES.usual_most_mm:g} mm; {place}, read in {unit}, has {size:.4g} mm"
        )
        warn(text, UnitWarning)


def _likely_unit(extent: float) -> str | None:
    """Return the unit in which an extent is a usual body's, or else may be one's; None if there is none.

    Of several, millimetres are the commonest; otherwise the one that brings the extent closest to a usual body's.
    """
    usual, possible = (FILES.usual_least_mm, FILES.usual_most_mm), (FILES.least_extent_mm, FILES.most_extent_mm)
    for least, most in (usual, possible):
        apart = {
            unit: (unit != "mm", abs(float(np.log(extent * factor / FILES.typical_extent_mm))))
            for unit, factor in UNITS_MM.items()
            if least <= extent * factor <= most
        }
        if apart:
            return min(apart, key=lambda unit: apart[unit])
    return None
