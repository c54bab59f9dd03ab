"""Whether markers lie on this body at all: their distances from its surface scatter as no mounting explains."""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.likelihood import standoff
from tissuereg.registration.readings.settings import CHECKS
from tissuereg.registration.readings.words import Suspicion


def scattered(distance: FloatArray, extent: float) -> list[Suspicion]:
    """Return the suspicion that markers are those of another body.

    `distance` (n_markers,): signed distances of the reference places from the surface, negative inside, mm; `extent`:
    of the body, mm. Result: at most one: where markers mounted on the skin at one height, each with an error, are as
    improbable as markers that were all placed inside (chi-squares of the distances).
    """
    from scipy.stats import chi2

    n = len(distance)
    if n < CHECKS.fewest:
        return []
    height = float(np.clip(distance.mean(), 0.0, standoff(extent)))
    mounted = np.sum((distance - height) ** 2) / (CHECKS.mounted * standoff(extent)) ** 2
    inside = np.sum(np.maximum(distance, 0.0) ** 2) / (CHECKS.inside_mm + CHECKS.inside_share * extent) ** 2
    if max(chi2.sf(mounted, n - 1), chi2.sf(inside, n)) >= CHECKS.level:
        return []
    low, high = float(distance.min()), float(distance.max())
    text = (
        f"places: the markers lie from {-min(low, 0.0):.1f} mm below the surface of the undeformed body to "
        f"{max(high, 0.0):.1f} mm above it; they may be those of another body"
    )
    return [Suspicion("places", text)]
