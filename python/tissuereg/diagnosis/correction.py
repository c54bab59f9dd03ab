"""Correction of the discretisation error: predictions on the user's mesh, carried to a finer mesh.

Markers get an additive difference. Forces get a linear map per frame and pad plus a difference, because a coarse mesh
is too stiff by a factor. A fitted effect may have a further difference (`OfEffect`), proportional to the effect.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.simulation.fine.reading import force_maps, mapped


@dataclass(frozen=True, eq=False)
class OfEffect:
    """The discretisation error of one effect, for predictions that contain more or less of the effect.

    `base` (size,): prediction of the believed model on the user's mesh; `change` (size,): change that the effect makes
    there; `along` (size,): weights whose scalar product with a change is the amount of the effect in it: 0 for no
    change, 1 for `change`; `difference` (size,): prediction with the effect on the fine mesh minus the corrected one of
    the user's mesh. All in mm and mN, at the believed modulus.
    """

    base: FloatArray
    change: FloatArray
    along: FloatArray
    difference: FloatArray

    def share(self, coarse: FloatArray) -> FloatArray:
        """Return the amount (...) of the effect in predictions (..., size) at the believed modulus, mm and mN."""
        return np.asarray((coarse - self.base) @ self.along)

    def other(self, coarse: FloatArray) -> FloatArray:
        """Return the part (..., size), mm and mN, of a prediction's change that is no multiple of the effect's."""
        return np.asarray(coarse - self.base - self.share(coarse)[..., None] * self.change)


@dataclass(frozen=True, eq=False)
class Correction:
    """The correction from the user's mesh to a finer one: a difference for markers, a linear map per frame for forces.

    Forces need a map because their error is proportional to modulus and memory; that of the markers depends on the
    motion alone. `maps`: by name of the case, matrices (n_frames, n_pads, 3, 3); forces of other cases are not mapped;
    `difference` (size,): fine minus mapped prediction, mm and mN; `modulus`: over the believed one, for which
    derivatives are given; `of_effect`: the further discretisation error of a fitted effect; None where there is none.
    """

    layout: SignalLayout
    maps: Mapping[str, FloatArray] = field(default_factory=dict)
    difference: FloatArray | float = 0.0
    modulus: float = 1.0
    of_effect: OfEffect | None = None

    def corrected(self, coarse: FloatArray, modulus: float = 1.0) -> FloatArray:
        """Return predictions (..., size) with a modulus, over the believed one, as the finer mesh would give them."""
        scale, missing, effect = self._scale(modulus), self.difference, self.of_effect
        if effect is not None:
            missing = missing + effect.share(coarse / scale)[..., None] * effect.difference
        return self._mapped(coarse) + scale * missing

    def of_columns(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) at the believed modulus, converted to the finer mesh and to `self.modulus`."""
        return self.at_modulus(self._mapped(columns))

    def at_modulus(self, columns: FloatArray) -> FloatArray:
        """Return derivatives (..., size) of a prediction, converted from the believed modulus to `self.modulus`."""
        return np.asarray(columns * self._scale(self.modulus))

    def with_effect(self, base: FloatArray, coarse: FloatArray, fine: FloatArray, std: FloatArray) -> "Correction":
        """Return a correction that is exact for the believed model and for the model with an effect.

        `base`, `coarse` (size,): predictions on the user's mesh without and with the effect, at the believed modulus,
        mm and mN; `fine` (size,): that on the fine mesh with the effect; `std` (size,): deviation of the noise, mm and
        mN, by which the amount of the effect is weighted. Returns this correction where the effect changes nothing.
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
    """Return the correction that maps a prediction on one mesh exactly to that on another.

    `coarse`, `fine` (size,): predictions of the believed model on two meshes, mm and mN. The result has one 3 x 3 map
    of forces for each frame and pad.
    """
    maps = {}
    for part in layout.parts:
        rough, good = part.forces(coarse), part.forces(fine)
        maps[part.name] = np.zeros((*rough.shape, 3))
        for i in range(len(part.pads)):
            maps[part.name][:, i] = force_maps(rough[:, i], good[:, i])
    exact = Correction(layout, maps)
    return replace(exact, difference=fine - exact.corrected(coarse))
