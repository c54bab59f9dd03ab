"""A trivial baseline, which does well in easy tests: every point moves by the mean motion of the markers."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray, float_array
from tissuereg_paper.rivals.rival import Estimate, Rival


def copied_displacement(reference: Any, measured: Any, points: Any) -> FloatArray:
    """Return the markers' mean displacement at every point.

    Parameters
    ----------
    reference, measured : array_like of float, shape (n_markers, 3)
        Markers before and after, mm.
    points : array_like of float, shape (n_points, 3)
        Points at which the displacement is evaluated, mm.

    Returns
    -------
    ndarray of float64, shape (n_points, 3)
        mm.
    """
    before = float_array("reference", reference, (None, 3))
    after = float_array("measured", measured, (len(before), 3))
    wanted = float_array("points", points, (None, 3))
    return np.tile((after - before).mean(axis=0), (len(wanted), 1))


class MeanOfMarkers(Rival):
    """Every node moves by the mean displacement of the markers that were seen; see `copied_displacement`."""

    name: ClassVar[str] = "mean of the markers"

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the markers' mean displacement at every node; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        reference, nodes = self.setting.reference_mm[moment.seen], self.setting.mesh.nodes
        return Estimate(copied_displacement(reference, moment.measured_mm[moment.seen], nodes))
