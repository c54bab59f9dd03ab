"""A thin-plate spline through the markers, affine where there are too few of them."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import real
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg_paper.rivals.copy import copied_displacement
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting


def spline_displacement(reference: Any, measured: Any, points: Any, smoothing: Any = 0.0) -> FloatArray:
    """Return the displacement of points under a thin-plate spline through the markers, or near them.

    Parameters
    ----------
    reference, measured : array_like of float, shape (n_markers, 3)
        Markers before and after, mm.
    points : array_like of float, shape (n_points, 3)
        Points at which the displacement is evaluated, mm.
    smoothing : float or array_like of float, shape (n_markers,)
        What is added to the diagonal of the kernel's matrix ``r^2 log r`` for each marker, mm^2: 0 interpolates.

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

    given = RBFInterpolator(before, after - before, kernel="thin_plate_spline", smoothing=smoothing)
    return np.asarray(given(wanted))


class Spline(Rival):
    """The thin-plate spline through the markers that were seen, or near them; see `spline_displacement`.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    smoothing : float
        Smoothing of a marker over the variance of its noise: the noisier, the smoother.
    """

    name: ClassVar[str] = "thin-plate spline"

    def __init__(self, setting: Setting, *, smoothing: float = 0.0) -> None:
        super().__init__(setting)
        self._smoothing: FloatArray = real("smoothing", smoothing, least=0.0) * setting.std_mm**2

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the spline's displacement of the nodes; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        seen, nodes = moment.seen, self.setting.mesh.nodes
        return Estimate(
            spline_displacement(self.setting.reference_mm[seen], moment.measured_mm[seen], nodes, self._smoothing[seen])
        )
