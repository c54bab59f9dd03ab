"""Fit of the unlabelled surface points after a registration."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.surface import SurfacePoints
from tissuereg.registration.contacts.settings import MATCHING, ReportSettings
from tissuereg.registration.contacts.state import BodyState
from tissuereg.registration.contacts.surface_points import PointData


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """Fit of the measured points of the surface, which have no labels, after a registration.

    Attributes
    ----------
    points : int
        Number of points that took part.
    used : int
        Number of them that are not outliers.
    thinned_from : int or None
        Number of points given, if more than took part; otherwise None.
    before_rms_mm, after_rms_mm : float
        Root mean square distance of the used points from the surface along its normal, mm: under the believed load (or
        at rest), and after registration.
    outliers : ndarray of int64, shape (n_outliers,)
        Rows of the given points more than four standard deviations from the surface.
    typical : float
        Median distance over its value under the stated noise; about 1.
    misfit : float
        Sum of squares of the used points' distances over their standard deviations.
    places : ndarray of float64, shape (points, 3)
        Places of the points as measured, in the tracker's frame, mm.
    std_mm : float
        Stated standard deviation of a point's place along the surface's normal, mm.
    """

    points: int
    used: int
    thinned_from: int | None
    before_rms_mm: float
    after_rms_mm: float
    outliers: IntArray
    typical: float
    misfit: float
    places: FloatArray
    std_mm: float

    @classmethod
    def of(cls, observed: PointData, given: SurfacePoints, start: BodyState, end: BodyState) -> "SurfaceFit":
        """Return the fit of the points at the start and the end of a registration.

        `observed`: the points as data; `given`: the points as measured; `start`, `end`: the body before and after.
        """
        before, after = observed.distances(start)[0], observed.distances(end)
        good = after[1] <= MATCHING.outlier
        return cls(
            points=len(given),
            used=int(good.sum()),
            thinned_from=given.given if given.given > len(given) else None,
            before_rms_mm=_rms(before[good]),
            after_rms_mm=_rms(after[0][good]),
            outliers=given.rows[~good],
            typical=float(np.median(after[1]) / 0.6745),
            misfit=float(np.sum(after[1][good] ** 2)),
            places=given.places,
            std_mm=given.std,
        )

    def to_json(self) -> dict[str, Any]:
        """Return numbers of points, distances in mm and outliers as a dict of plain numbers and lists."""
        return {
            "points": self.points,
            "used": self.used,
            "thinned_from": self.thinned_from,
            "before_rms_mm": self.before_rms_mm,
            "after_rms_mm": self.after_rms_mm,
            "outliers": self.outliers.tolist(),
        }

    def reasons(self, settings: ReportSettings) -> list[str]:
        """Return the reasons not to trust the result that the points give, in sentences; empty if there are none."""
        found = []
        if self.typical > settings.most_off:
            found.append(
                f"the surface points do not lie on the registered surface: they are typically {self.typical:.1f} "
                f"times as far off as their noise allows ({self.after_rms_mm:.2f} mm rms)"
            )
        share = 1.0 - self.used / self.points
        if share > settings.most_outliers:
            found.append(f"{100 * share:.0f} % of the surface points belong to no part of the registered surface")
        return found


def _rms(lengths: FloatArray) -> float:
    return float(np.sqrt(np.mean(lengths**2))) if len(lengths) else 0.0
