"""A thin-plate spline through the markers, affine where there are too few of them."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._arrays import FloatArray, float_array
from tissuereg.baselines.copy import copied_displacement
from tissuereg.baselines.rival import Estimate, Rival


def spline_displacement(reference: Any, measured: Any, points: Any) -> FloatArray:
    """Return the displacement of points under a thin-plate spline through the markers.

    Parameters
    ----------
    reference, measured : array_like of float, shape (n_markers, 3)
        Markers before and after, mm.
    points : array_like of float, shape (n_points, 3)
        Points at which the displacement is evaluated, mm.

    Returns
    -------
    ndarray of float64, shape (n_points, 3)
        mm. With fewer than four markers, or all in one plane, the spline's affine part is not defined and the
        markers' mean displacement is returned.
    """
    before = float_array("reference", reference, (None, 3))
    after = float_array("measured", measured, (len(before), 3))
    wanted = float_array("points", points, (None, 3))
    spread = np.linalg.svd(before - before.mean(axis=0), compute_uv=False)
    if len(before) < 4 or spread[-1] < 1e-9 * spread[0]:
        return copied_displacement(before, after, wanted)
    from scipy.interpolate import RBFInterpolator

    return np.asarray(RBFInterpolator(before, after - before, kernel="thin_plate_spline")(wanted))


class Spline(Rival):
    """The thin-plate spline through the markers that were seen; see `spline_displacement`."""

    name: ClassVar[str] = "thin-plate spline"

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the spline's displacement of the nodes; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        reference, nodes = self.setting.reference_mm[moment.seen], self.setting.mesh.nodes
        return Estimate(spline_displacement(reference, moment.measured_mm[moment.seen], nodes))
