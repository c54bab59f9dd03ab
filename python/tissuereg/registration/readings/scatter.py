"""Whether markers lie on this body at all: their distances from its surface scatter as no mounting explains."""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.likelihood import standoff
from tissuereg.registration.readings.words import Suspicion

#: Largest plausible error of a mounting as a share of the largest height above the skin; that of a marker placed inside
#: the body, mm and share of the extent: it cannot stick out.
_MOUNTED, _INSIDE_MM, _INSIDE_SHARE = 0.4, 0.3, 0.003

#: Chance below which a mounting is out of the question.
_LEVEL = 1e-3

#: Fewest markers whose scatter tells.
_FEWEST = 5


def scattered(distance: FloatArray, extent: float) -> list[Suspicion]:
    """Return the suspicion that markers are those of another body.

    Parameters
    ----------
    distance : ndarray of float64, shape (n_markers,)
        Signed distances of the reference places from the surface, negative inside, mm.
    extent : float
        Of the body, mm.

    Returns
    -------
    list of Suspicion
        At most one: where markers mounted on the skin at one height, each with an error, are as improbable as markers
        that were all placed inside (chi-squares of the distances).
    """
    from scipy.stats import chi2

    n = len(distance)
    if n < _FEWEST:
        return []
    height = float(np.clip(distance.mean(), 0.0, standoff(extent)))
    mounted = np.sum((distance - height) ** 2) / (_MOUNTED * standoff(extent)) ** 2
    inside = np.sum(np.maximum(distance, 0.0) ** 2) / (_INSIDE_MM + _INSIDE_SHARE * extent) ** 2
    if max(chi2.sf(mounted, n - 1), chi2.sf(inside, n)) >= _LEVEL:
        return []
    low, high = float(distance.min()), float(distance.max())
    text = (
        f"places: the markers lie from {-min(low, 0.0):.1f} mm below the surface of the undeformed body to "
        f"{max(high, 0.0):.1f} mm above it; they may be those of another body"
    )
    return [Suspicion("places", text)]
