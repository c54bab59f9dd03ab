"""The best rigid motion of the markers (Kabsch)."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.errors import MarkerError
from tissuereg_paper.rivals.copy import copied_displacement
from tissuereg_paper.rivals.rival import Estimate, Rival


def rigid_displacement(reference: Any, measured: Any, points: Any) -> FloatArray:
    """Return the displacement of points under the best rigid motion of the markers.

    Parameters
    ----------
    reference, measured : array_like of float, shape (n_markers, 3)
        Markers before and after, mm; at least three.
    points : array_like of float, shape (n_points, 3)
        Points at which the displacement is evaluated, mm.

    Returns
    -------
    ndarray of float64, shape (n_points, 3)
        mm.

    Raises
    ------
    MarkerError
        If there are fewer than three markers.

    References
    ----------
    .. [1] W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32, 922-923,
       1976. doi:10.1107/S0567739476001873
    """
    before = float_array("reference", reference, (None, 3))
    after = float_array("measured", measured, (len(before), 3))
    wanted = float_array("points", points, (None, 3))
    if len(before) < 3:
        message = f"a rigid motion needs at least three markers, got {len(before)}"
        raise MarkerError(message, where="reference")
    from scipy.spatial.transform import Rotation

    turn, _ = Rotation.align_vectors(after - after.mean(axis=0), before - before.mean(axis=0))
    return np.asarray(turn.apply(wanted - before.mean(axis=0)) + after.mean(axis=0) - wanted)


class Rigid(Rival):
    """The best rigid motion of the markers that were seen, and their mean displacement where fewer than three were."""

    name: ClassVar[str] = "rigid"

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the displacement of the nodes under that motion; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        rule = rigid_displacement if len(moment.seen) >= 3 else copied_displacement
        reference, nodes = self.setting.reference_mm[moment.seen], self.setting.mesh.nodes
        return Estimate(rule(reference, moment.measured_mm[moment.seen], nodes))
