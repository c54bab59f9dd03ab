"""Variants of a rig's simulation: what else the body may be and how else it may be held, simulated beforehand."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import open_npz
from tissuereg_paper.studies.rigs import Rig, inverted, on_spline

#: Young's modulus of the stored variants, and those with which each is taken: as far apart as it is uncertain, kPa.
STORED_KPA, YOUNG_KPA, N_MODULI = 10.0, (5.0, 20.0), 5

#: A variant is followed this far beyond its last equilibrium, as a share of the push there, along the straight line.
_BEYOND = 1.1

#: Points of the curve of push by level that is inverted.
_FINE = 801


@dataclass(frozen=True, eq=False)
class RigVariants:
    """Variants of one rig along growing pushes.

    Attributes
    ----------
    fields_mm : ndarray of float64, shape (n_variants, n_levels, n_nodes, 3)
        Displacements at equilibria, NaN beyond the last one.
    pushes : ndarray of float64, shape (n_variants, n_levels)
        How hard the pads push there along their strokes together, mN.
    young_kpa : tuple of (float, float)
        Least and largest Young's modulus with which each is taken, kPa.
    """

    fields_mm: FloatArray
    pushes: FloatArray
    young_kpa: tuple[float, float] = YOUNG_KPA

    def at(self, push: float) -> FloatArray:
        """Return all variants under a push in mN, (n, n_nodes, 3) in mm; those that it presses too far are left out.

        A body whose modulus is twice as large is moved by twice the push as far, so that each variant is taken with
        several moduli.
        """
        steps = (np.arange(N_MODULI)[None] + _spread_evenly(len(self.pushes))[:, None]) / N_MODULI
        low, high = np.log(self.young_kpa)
        wanted = push * STORED_KPA / np.exp(low + (high - low) * steps)
        found = [
            field
            for fields, pushes, several in zip(self.fields_mm, self.pushes, wanted, strict=True)
            for field in _along(fields, pushes, several)
        ]
        return np.array(found).reshape(-1, *self.fields_mm.shape[2:])


def read_variants(folder: str | os.PathLike[str], rig: Rig, n_nodes: int) -> RigVariants:
    """Read the variants of a rig.

    Parameters
    ----------
    folder : path-like
        Holds files of the rigs' names, as ``bench/twin/variants.py`` makes them.
    rig : Rig
    n_nodes : int
        Of the mesh.

    Returns
    -------
    RigVariants

    Raises
    ------
    FormatError
        If the file is missing or spoilt, or an array of it is not as stated.
    """
    with open_npz(file_of(folder, rig)) as file:
        pushes = file.floats("push_mN", None, None, finite=False)
        low, high = (float(one) for one in file.floats("young_kpa", 2)) if "young_kpa" in file else YOUNG_KPA
        fields = file.floats("field_mm", *pushes.shape, n_nodes, 3, finite=False)
        return RigVariants(fields, pushes, (low, high))


def file_of(folder: str | os.PathLike[str], rig: Rig) -> Path:
    """Return the file of a rig's variants."""
    return place("variants", folder, error=FormatError) / f"{rig.name}.npz"


def digest(folder: str | os.PathLike[str], rig: Rig) -> str:
    """Return what tells the variants of a rig from others; empty if there are none."""
    path = file_of(folder, rig)
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.exists() else ""


def _spread_evenly(count: int) -> FloatArray:
    """Return numbers (count,) between 0 and 1, spread evenly however many are taken: multiples of the golden ratio."""
    return np.asarray((np.arange(count) + 0.5) * 0.6180339887498949 % 1.0)


def _along(fields: FloatArray, pushes: FloatArray, wanted: FloatArray) -> list[FloatArray]:
    """Return the displacements of one variant (n_levels, n_nodes, 3) at wanted pushes (k,), as far as it is known."""
    known = int(np.isfinite(pushes).sum())
    if known < 2:
        return []
    levels = np.arange(known + 1.0)
    path = np.concatenate([np.zeros_like(fields[:1]), fields[:known]])
    places, hardest = inverted(levels, np.concatenate([[0.0], pushes[:known]]), wanted, _FINE)
    beyond = wanted[(wanted > hardest) & (wanted <= _BEYOND * hardest)]
    return [*on_spline(levels, path, places[wanted <= hardest]), *(path[-1] * push / hardest for push in beyond)]
