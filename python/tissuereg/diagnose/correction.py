"""The error of the user's mesh, taken from a finer one and put right in every prediction."""

from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.signals import Layout


@dataclass(frozen=True, eq=False)
class Correction:
    """What a finer mesh changes: forces by a factor, markers and the rest by a difference.

    A factor, because forces follow modulus and memory as a whole; the error of the markers hangs on motion alone.

    Attributes
    ----------
    factor : ndarray of float64, shape (size,)
        One for markers.
    difference : ndarray of float64, shape (size,)
        Fine less factor times coarse, mm and mN.
    force : ndarray of bool, shape (size,)
        Which entries are forces.
    modulus : float
        Over the believed one, where derivatives are taken: forces grow with it.
    """

    factor: FloatArray
    difference: FloatArray
    force: BoolArray
    modulus: float = 1.0

    def corrected(self, coarse: FloatArray, modulus: float = 1.0) -> FloatArray:
        """Return predictions (..., size) as the finer mesh would give them; the modulus is over the believed one."""
        return coarse * self.factor + np.where(self.force, modulus, 1.0) * self.difference

    def of_columns(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of the believed model as the finer mesh would give them at the modulus."""
        return columns * (np.where(self.force, self.modulus, 1.0) * self.factor)


def make_correction(layout: Layout, coarse: FloatArray, fine: FloatArray) -> Correction:
    """Return the correction that carries one prediction into another.

    Parameters
    ----------
    layout : Layout
        Order of both.
    coarse, fine : ndarray of float64, shape (size,)
        What the believed model says on two meshes.

    Returns
    -------
    Correction
        One factor a case and pad.
    """
    factor = np.ones(layout.size)
    for part in layout.parts:
        for i in range(len(part.pads)):
            rough, good = part.forces(coarse)[:, i], part.forces(fine)[:, i]
            power = float((rough**2).sum())
            if power > 0.0:
                part.forces(factor)[:, i] = float((rough * good).sum()) / power
    return Correction(factor, fine - factor * coarse, ~layout.of_markers())
