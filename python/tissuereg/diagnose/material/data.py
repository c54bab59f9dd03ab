"""The stresses that count: rows of every curve, thinned, each with what a smooth misfit could depend on."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.diagnose.material.history import stress_of
from tissuereg.diagnose.material.model import Model
from tissuereg.material_experiment import Curve, MaterialExperiment

BoolArray = npt.NDArray[np.bool_]

#: Rows used at most, of all curves together; more would count the same smooth error again and again.
MAX_ROWS = 320


@dataclass(frozen=True, eq=False)
class Data:
    """Rows used, curve after curve.

    Attributes
    ----------
    curves : tuple of Curve
        Those of the experiment, or some of them.
    rows : tuple of ndarray of int64
        Rows used of each.
    stress : ndarray of float64, shape (n,)
        kPa.
    curve_of : ndarray of int64, shape (n,)
        Index of the curve.
    level : ndarray of float64, shape (n,)
        Size of the stress there, a tenth of the curve's peak added, kPa: what relative errors multiply.
    arc : ndarray of float64, shape (n,)
        Progress along the load history, 0 to 1, strain and time counting half each.
    strain : ndarray of float64, shape (n,)
        Strain over the largest of its mode.
    log_rate : ndarray of float64, shape (n,)
        Decadic logarithm of the rate; 0 where it is not known.
    """

    curves: tuple[Curve, ...]
    rows: tuple[IntArray, ...]
    stress: FloatArray
    curve_of: IntArray
    level: FloatArray
    arc: FloatArray
    strain: FloatArray
    log_rate: FloatArray

    @property
    def modes(self) -> list[str]:
        """Mode of every row."""
        return [self.curves[c].mode for c in self.curve_of]

    @property
    def specimens(self) -> list[str]:
        """Specimen of every row."""
        return [self.curves[c].specimen for c in self.curve_of]

    def part(self, kept: BoolArray) -> "Data":
        """Return some of the rows.

        Parameters
        ----------
        kept : ndarray of bool, shape (n,)
            Which.

        Returns
        -------
        Data
            All curves stay; those without rows are not asked.
        """
        rows = tuple(rows[kept[self.curve_of == i]] for i, rows in enumerate(self.rows))
        columns: tuple[Any, ...] = (self.stress, self.curve_of, self.level, self.arc, self.strain, self.log_rate)
        return Data(self.curves, rows, *(column[kept] for column in columns))

    def modelled(self, model: Model) -> FloatArray:
        """Return what a model answers.

        Parameters
        ----------
        model : Model
            Law and memory.

        Returns
        -------
        ndarray of float64, shape (n,)
            Stress at the rows, kPa; NaN where the law has none.
        """
        parts = [stress_of(model, c, rows) for c, rows in zip(self.curves, self.rows, strict=True) if len(rows)]
        return np.concatenate(parts)


def data_of(experiment: MaterialExperiment, max_rows: int = MAX_ROWS) -> Data:
    """Return the rows of an experiment that count.

    Parameters
    ----------
    experiment : MaterialExperiment
        With its curves.
    max_rows : int
        Of all curves together.

    Returns
    -------
    Data
        Rows evenly spaced along each load history.
    """
    curves = experiment.curves
    share = max(12, max_rows // len(curves))
    largest: dict[str, float] = {}
    for curve in curves:
        largest[curve.mode] = max(largest.get(curve.mode, 0.0), float(np.abs(curve.strains).max()))
    rows: list[IntArray] = []
    parts: list[tuple[Any, ...]] = []
    for index, curve in enumerate(curves):
        arc = path_arc(curve)
        kept = _thinned(curve, arc, share)
        rows.append(kept)
        stress = curve.stress[kept]
        peak = float(np.nanmax(np.abs(curve.stress)))
        rate = 0.0 if np.isnan(curve.rate) else float(np.log10(curve.rate))
        parts.append(
            (
                stress,
                np.full(len(kept), index),
                np.abs(stress) + 0.1 * peak,
                arc[kept],
                curve.strains[kept] / largest[curve.mode],
                np.full(len(kept), rate),
            )
        )
    columns: list[Any] = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Data(curves, tuple(rows), *columns)


def path_arc(curve: Curve) -> FloatArray:
    """Return how far each row lies along its load history, 0 to 1.

    Parameters
    ----------
    curve : Curve
        With or without times.

    Returns
    -------
    ndarray of float64, shape (n,)
        Strain passed and time passed count half each; without times strain alone.
    """
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(curve.amounts)))])
    strain = moved / (moved[-1] or 1.0)
    times = curve.times
    if not np.isfinite(times).all() or times[-1] <= times[0]:
        return np.asarray(strain)
    return np.asarray(0.5 * strain + 0.5 * (times - times[0]) / (times[-1] - times[0]))


def _thinned(curve: Curve, arc: FloatArray, share: int) -> IntArray:
    measured = np.flatnonzero(np.isfinite(curve.stress))
    # The state of rest is what stress is counted from: it tells nothing.
    told = measured[(np.abs(curve.strains[measured]) > 0) | (np.abs(curve.stress[measured]) > 0)]
    if len(told) <= share:
        return np.asarray(told)
    places = np.interp(np.linspace(0.0, 1.0, share), _grown(arc[told]), np.arange(len(told)))
    return np.asarray(told[np.unique(np.round(places).astype(np.int64))])


def _grown(arc: FloatArray) -> FloatArray:
    """Return a progress from 0 to 1 that also grows with the number of rows, so that jumps keep some."""
    count = np.linspace(0.0, 1.0, len(arc))
    span = float(arc[-1] - arc[0]) or 1.0
    return np.asarray(0.5 * (arc - arc[0]) / span + 0.5 * count)
