"""Correction of the discretisation error: predictions on the user's mesh, carried to a finer mesh.

Markers get an additive difference. Forces get a linear map per frame and pad plus a difference, because a coarse mesh
is too stiff by a factor. A fitted effect may have a term of its own (`OfEffect`), proportional to the effect.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.simulation.fine.reading import force_maps, mapped


@dataclass(frozen=True, eq=False)
class OfEffect:
    """The discretisation error of one effect, for predictions that have more or less of the effect.

    `base` (size,): prediction of the believed model on the user's mesh, mm and mN; `change` (size,): change that the
    effect makes there; `along` (size,): its scalar product with a change is the amount of the effect in it: 0 for the
    believed model, 1 for the effect; `difference` (size,): fine minus corrected prediction with the effect, at the
    believed modulus, mm and mN.
    """

    base: FloatArray
    change: FloatArray
    along: FloatArray
    difference: FloatArray

    def share(self, coarse: FloatArray) -> FloatArray:
        """Return the amount of the effect in predictions (..., size) on the user's mesh, at the believed modulus."""
        return np.asarray((coarse - self.base) @ self.along)

    def at(self, coarse: FloatArray) -> FloatArray:
        """Return the correction (..., size), mm and mN, of predictions (..., size) on the user's mesh."""
        return np.asarray(self.share(coarse)[..., None] * self.difference)

    def other(self, coarse: FloatArray) -> FloatArray:
        """Return the part of the change in predictions (..., size), on the user's mesh, beside multiples of the effect.
        """
        return np.asarray(coarse - self.base - self.share(coarse)[..., None] * self.change)


@dataclass(frozen=True, eq=False)
class Correction:
    """The correction from the user's mesh to a finer one: a difference for markers, a linear map per frame for forces.

    Forces need a map because their error is proportional to modulus and memory; the error of the markers depends on the
    motion alone. `layout`: order of the data; `maps` (n_frames, n_pads, 3, 3): maps of forces by case; forces of other
    cases are unchanged; `difference` (size,): fine minus mapped prediction, mm and mN; `modulus`: modulus over the
    believed one at which derivatives are taken; forces are proportional to it; `of_effect`: correction of a fitted
    effect.
    """

    layout: SignalLayout
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
        """Return derivatives (..., size) of the user's mesh as the finer mesh would give them at the modulus."""
        return self.at_modulus(self._mapped(columns))

    def at_modulus(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of a fine mesh at the believed modulus, converted to the present modulus."""
        return np.asarray(columns * self._scale(self.modulus))

    def with_effect(self, base: FloatArray, coarse: FloatArray, fine: FloatArray, std: FloatArray) -> "Correction":
        """Return a correction that is exact for the believed model and for the model with an effect.

        `base`, `coarse` (size,): the user's mesh without and with the effect, at the believed modulus; `fine` (size,):
        the fine mesh with it; `std` (size,): noise, by which the amount of the effect in a prediction is weighted.
        Result: itself where the effect changes nothing.
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


def make_correction(layout: SignalLayout, coarse: FloatArray, fine: FloatArray) -> Correction:
    """Return the correction that maps one prediction exactly to another.

    `layout`: order of both; `coarse`, `fine` (size,): predictions of the believed model on two meshes. Result: with one
    map for each frame and pad.
    """
    maps = {}
    for part in layout.parts:
        rough, good = part.forces(coarse), part.forces(fine)
        maps[part.name] = np.zeros((*rough.shape, 3))
        for i in range(len(part.pads)):
            maps[part.name][:, i] = force_maps(rough[:, i], good[:, i])
    exact = Correction(layout, maps)
    return replace(exact, difference=fine - exact.corrected(coarse))
