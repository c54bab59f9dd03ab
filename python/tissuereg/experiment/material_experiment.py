"""A material-test experiment: the believed material of a specimen, and the measured stress-strain curves.

The classes are plain data, which `tissuereg.io.material_experiments.read_material_experiment` reads from a folder.
Stresses are in kPa, times in s.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.material import Material
from tissuereg.errors import ExperimentError

if TYPE_CHECKING:
    from tissuereg.experiment.effects.base import Effect

#: Modes of a test.
TEST_MODES = ("tension", "compression", "simple-shear")

#: Units that can be held out for the proof of a finding.
HELD_OUT = ("mode", "rate", "specimen")


@dataclass(frozen=True, eq=False)
class Curve:
    """One measured stress-strain curve: a load history of one specimen, which begins at rest.

    Parameters
    ----------
    specimen : str
        Name of the specimen.
    mode : str
        Kind of loading: ``tension``, ``compression`` or ``simple-shear``.
    rate : float
        Nominal strain rate in 1/s; NaN where not known.
    times : ndarray of float64, shape (n,)
        Time of each row in s, never decreasing; NaN throughout where not known.
    amounts : ndarray of float64, shape (n,)
        Stretch (length over undeformed length), or amount of shear; dimensionless.
    stress : ndarray of float64, shape (n,)
        Nominal stress in kPa, compression negative; NaN where not measured.

    Raises
    ------
    ExperimentError
        If the mode is unknown, columns differ in length, a stretch is not positive, times are given in part or
        decrease, fewer than three stresses are measured, or stress and strain have opposite signs on the whole.
    """

    specimen: str
    mode: str
    rate: float
    times: FloatArray
    amounts: FloatArray
    stress: FloatArray

    def __post_init__(self) -> None:
        for key in ("times", "amounts", "stress"):
            object.__setattr__(self, key, np.array(getattr(self, key), dtype=np.float64))
        if self.mode not in TEST_MODES:
            self._refuse(f"its mode must be one of {', '.join(TEST_MODES)}", self.mode)
        if not len(self.amounts) == len(self.times) == len(self.stress):
            lengths = [len(self.times), len(self.amounts), len(self.stress)]
            self._refuse("times, stretches and stresses must be equally many", lengths)
        if not np.isfinite(self.amounts).all():
            self._refuse("every stretch or amount of shear must be finite", "one that is not")
        if self.mode != "simple-shear" and (self.amounts <= 0).any():
            self._refuse("stretches must be positive (length over undeformed length)", float(self.amounts.min()))
        known = np.isfinite(self.times)
        if known.any() and not (known.all() and (np.diff(self.times) >= 0).all()):
            self._refuse("times must be given in all rows or in none, and never fall", "others")
        if not (np.isnan(self.rate) or (np.isfinite(self.rate) and self.rate > 0)):
            self._refuse("its rate must be positive", self.rate)
        measured = np.isfinite(self.stress)
        if measured.sum() < 3:
            self._refuse("at least three stresses must be measured", int(measured.sum()))
        work = float(np.nansum(self.stress * self.strains))
        if work <= 0:
            self._refuse("stress must have the sign of the strain (compression negative)", f"a sum of {work:.3g}")

    @property
    def name(self) -> str:
        """Title of the curve: specimen, mode and, where it is known, rate."""
        rate = "" if np.isnan(self.rate) else f" at {self.rate:.4g}/s"
        return f"{self.specimen} {self.mode}{rate}"

    @property
    def strains(self) -> FloatArray:
        """Strain of each row, shape (n,), dimensionless: stretch minus 1, or amount of shear."""
        return self.amounts if self.mode == "simple-shear" else self.amounts - 1.0

    @property
    def timed(self) -> bool:
        """Whether the time of each row is known, from `times` or from `rate`."""
        return bool(np.isfinite(self.times).all()) or not np.isnan(self.rate)

    @property
    def clock(self) -> FloatArray:
        """Time of each row in s, shape (n,), computed from the rate where none is given; NaN where neither is known."""
        if np.isfinite(self.times).all() or np.isnan(self.rate):
            return self.times
        moved = np.abs(np.diff(self.strains, prepend=0.0))
        return np.asarray(np.cumsum(moved) / self.rate)

    def _refuse(self, rule: str, found: object) -> None:
        message = f"in the test '{self.name}' {rule}, got {found}"
        raise ExperimentError(message, where=self.name)


@dataclass(frozen=True, eq=False)
class MaterialExperiment:
    """A material that the user believes in, and the stress-strain curves measured on specimens of it.

    Attributes
    ----------
    name : str
        Title of the experiment.
    folder : Path
        Folder that contains the file ``test.csv`` with the curves.
    material : Material
        Believed material, the same everywhere.
    young_std, poisson_std : float, optional
        Prior standard deviations of Young's modulus in kPa and of Poisson's ratio; None if not stated.
    curves : tuple of Curve
        Measured curves, at least one.
    effects : tuple of Effect
        Effects (such as relaxation or softening) that are part of the believed material.
    hold_out : str, optional
        Which curves a fit leaves out to test its prediction: those of one ``mode``, ``rate`` or ``specimen``; None if
        this is to be chosen from the data.
    stress_std : float, optional
        Standard deviation of one measured stress in kPa; None if it is to be estimated from the curves.
    """

    name: str
    folder: Path
    material: Material
    young_std: float | None
    poisson_std: float | None
    curves: tuple[Curve, ...]
    effects: "tuple[Effect, ...]" = ()
    hold_out: str | None = None
    stress_std: float | None = None

    def values(self, unit: str) -> list[str | float]:
        """Return the different modes, rates or specimens of the curves, in the order of the curves.

        Parameters
        ----------
        unit : str
            ``mode``, ``rate`` or ``specimen``.

        Returns
        -------
        list
            Names of modes or specimens, or rates in 1/s. Unknown rates (NaN) are left out.
        """
        found = [getattr(curve, unit) for curve in self.curves]
        return list(dict.fromkeys(v for v in found if v == v))
