"""The error of the user's mesh, taken from a finer one and put right in every prediction."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.signals import Layout
from tissuereg.simulate.fine.forces import force_maps, mapped


@dataclass(frozen=True, eq=False)
class OfEffect:
    """What a finer mesh changes of an effect, for predictions that have more or less of it.

    Attributes
    ----------
    base : ndarray of float64, shape (size,)
        The believed model on the user's mesh, mm and mN.
    change : ndarray of float64, shape (size,)
        What the effect changes there.
    along : ndarray of float64, shape (size,)
        Times a change it gives how much of the effect that is: 0 for the believed model, 1 for the effect itself.
    difference : ndarray of float64, shape (size,)
        Fine less corrected for the effect itself, at the believed modulus, mm and mN.
    """

    base: FloatArray
    change: FloatArray
    along: FloatArray
    difference: FloatArray

    def share(self, coarse: FloatArray) -> FloatArray:
        """Return how much of the effect predictions (..., size) of the user's mesh have, at the believed modulus."""
        return np.asarray((coarse - self.base) @ self.along)

    def at(self, coarse: FloatArray) -> FloatArray:
        """Return what is missing in such predictions (..., size)."""
        return np.asarray(self.share(coarse)[..., None] * self.difference)

    def other(self, coarse: FloatArray) -> FloatArray:
        """Return what such predictions (..., size) change that is no multiple of the effect."""
        return np.asarray(coarse - self.base - self.share(coarse)[..., None] * self.change)


@dataclass(frozen=True, eq=False)
class Correction:
    """What a finer mesh changes: markers by a difference, forces by a map a frame.

    A map, because forces follow modulus and memory as a whole; the error of the markers hangs on motion alone.

    Attributes
    ----------
    layout : Layout
        Order of all that is corrected.
    maps : mapping of str to ndarray of float64, shape (n_frames, n_pads, 3, 3)
        Of the forces of every case; those of other cases stay.
    difference : ndarray of float64, shape (size,), or 0
        Fine less mapped, mm and mN.
    modulus : float
        Over the believed one, where derivatives are taken: forces grow with it.
    of_effect : OfEffect, optional
        What was found has an error of its own on the user's mesh.
    """

    layout: Layout
    maps: Mapping[str, FloatArray] = field(default_factory=dict)
    difference: FloatArray | float = 0.0
    modulus: float = 1.0
    of_effect: OfEffect | None = None

    def corrected(self, coarse: FloatArray, modulus: float = 1.0) -> FloatArray:
        """Return predictions (..., size) as the finer mesh would give them; the modulus is over the believed one."""
        scale = self._scale(modulus)
        missing = self.difference if self.of_effect is None else self.difference + self.of_effect.at(coarse / scale)
        return self._mapped(coarse) + scale * missing

    def of_columns(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of the believed model as the finer mesh would give them at the modulus."""
        return self.at_modulus(self._mapped(columns))

    def at_modulus(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of a fine mesh at the believed modulus as they are at this one."""
        return np.asarray(columns * self._scale(self.modulus))

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
        change = coarse - base
        weighed = change / std**2
        power = float(weighed @ change)
        if power == 0.0:
            return self
        plain = replace(self, of_effect=None)
        return replace(plain, of_effect=OfEffect(base, change, weighed / power, fine - plain.corrected(coarse)))

    def _mapped(self, flat: FloatArray) -> FloatArray:
        carried: FloatArray = flat.copy()
        for part in self.layout.parts:
            if part.name in self.maps:
                part.forces(carried)[:] = mapped(part.forces(flat), self.maps[part.name])
        return carried

    def _scale(self, modulus: float) -> FloatArray:
        return np.asarray(np.where(self.layout.of_markers(), 1.0, modulus))


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
        One map a frame and pad.
    """
    maps = {}
    for part in layout.parts:
        rough, good = part.forces(coarse), part.forces(fine)
        maps[part.name] = np.zeros((*rough.shape, 3))
        for i in range(len(part.pads)):
            maps[part.name][:, i] = force_maps(rough[:, i], good[:, i])
    exact = Correction(layout, maps)
    return replace(exact, difference=fine - exact.corrected(coarse))
