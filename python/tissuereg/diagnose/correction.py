"""The error of the user's mesh, taken from a finer one and put right in every prediction."""

from dataclasses import dataclass, replace

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.signals import Layout


@dataclass(frozen=True, eq=False)
class OfEffect:
    """What a finer mesh changes of an effect, for predictions that have more or less of it.

    Attributes
    ----------
    base : ndarray of float64, shape (size,)
        The believed model on the user's mesh, mm and mN.
    along : ndarray of float64, shape (size,)
        Times a change it gives how much of the effect that is: 0 for the believed model, 1 for the effect itself.
    difference : ndarray of float64, shape (size,)
        Fine less corrected for the effect itself, at the believed modulus, mm and mN.
    """

    base: FloatArray
    along: FloatArray
    difference: FloatArray

    def at(self, coarse: FloatArray) -> FloatArray:
        """Return what is missing in predictions (..., size) of the user's mesh at the believed modulus."""
        return np.asarray(((coarse - self.base) @ self.along)[..., None] * self.difference)


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
    of_effect : OfEffect, optional
        What was found has an error of its own on the user's mesh.
    """

    factor: FloatArray
    difference: FloatArray
    force: BoolArray
    modulus: float = 1.0
    of_effect: OfEffect | None = None

    def corrected(self, coarse: FloatArray, modulus: float = 1.0) -> FloatArray:
        """Return predictions (..., size) as the finer mesh would give them; the modulus is over the believed one."""
        scale = np.where(self.force, modulus, 1.0)
        missing = self.difference if self.of_effect is None else self.difference + self.of_effect.at(coarse / scale)
        return coarse * self.factor + scale * missing

    def of_columns(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of the believed model as the finer mesh would give them at the modulus."""
        return columns * (np.where(self.force, self.modulus, 1.0) * self.factor)

    def with_effect(self, base: FloatArray, coarse: FloatArray, fine: FloatArray, std: FloatArray) -> "Correction":
        """Return the correction that is right for the believed model and for one with an effect.

        Parameters
        ----------
        base, coarse : ndarray of float64, shape (size,)
            The user's mesh without and with the effect, at the believed modulus.
        fine : ndarray of float64, shape (size,)
            The fine mesh with it.
        std : ndarray of float64, shape (size,)
            Of the noise: how much of the effect a prediction has is measured in it.

        Returns
        -------
        Correction
            Itself where the effect changes nothing.
        """
        weighed = (coarse - base) / std**2
        power = float(weighed @ (coarse - base))
        if power == 0.0:
            return self
        plain = replace(self, of_effect=None)
        return replace(plain, of_effect=OfEffect(base, weighed / power, fine - plain.corrected(coarse)))


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
