"""The data of fits: thinned rows of every curve, with the coordinates on which a smooth misfit may depend."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.material.history import stress_of
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Data:
    """The n rows (measured points) of all curves that are used in fits, curve after curve.

    Attributes
    ----------
    curves : tuple of Curve
        Curves of the experiment; some of them may have no rows.
    rows : tuple of ndarray of int64
        For each curve, the indices of its rows that are used.
    stress : ndarray of float64, shape (n,)
        Nominal stress, kPa, compression negative.
    curve_of : ndarray of int64, shape (n,)
        Index of the curve.
    level : ndarray of float64, shape (n,)
        Size of the stress plus a tenth of the curve's peak, kPa; relative errors are multiplied by it.
    arc : ndarray of float64, shape (n,)
        Progress along the load history, 0 to 1, strain and time counting half each.
    strain : ndarray of float64, shape (n,)
        Strain over the largest strain of its mode, -1 to 1.
    log_rate : ndarray of float64, shape (n,)
        Decadic logarithm of the strain rate in 1/s; 0 where it is not known.
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
        """Mode of every row: "tension", "compression" or "simple-shear"."""
        return [self.curves[c].mode for c in self.curve_of]

    @property
    def specimens(self) -> list[str]:
        """Name of the specimen of every row."""
        return [self.curves[c].specimen for c in self.curve_of]

    def part(self, kept: BoolArray) -> "Data":
        """Return the data with some of the rows.

        Parameters
        ----------
        kept : ndarray of bool, shape (n,)
            Whether each row is kept.

        Returns
        -------
        Data
            Data with all curves; those without rows contribute nothing.
        """
        rows = tuple(rows[kept[self.curve_of == i]] for i, rows in enumerate(self.rows))
        columns: tuple[Any, ...] = (self.stress, self.curve_of, self.level, self.arc, self.strain, self.log_rate)
        return Data(self.curves, rows, *(column[kept] for column in columns))

    def modelled(self, model: Model) -> FloatArray:
        """Return the nominal stresses that a model predicts at the rows.

        Parameters
        ----------
        model : Model
            Law, with effects of time and load history.

        Returns
        -------
        ndarray of float64, shape (n,)
            Stress at the rows, kPa; NaN where the law has no solution.
        """
        parts = [stress_of(model, c, rows) for c, rows in zip(self.curves, self.rows, strict=True) if len(rows)]
        return np.concatenate(parts)


def data_of(experiment: MaterialExperiment, max_rows: int = DEFAULT.material.most_rows) -> Data:
    """Return the rows (measured points) of an experiment that are used in fits.

    `experiment`: its curves are used; `max_rows`: largest number of rows of all curves together, but a curve may keep
    12 in any case. Result: rows evenly spaced along each load history.
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
    """Return the progress of each row along its load history, shape (n,), from 0 to 1.

    `curve`: n rows, with or without times. Progress is the mean of two shares: of the path length in strain and of the
    time; without times it is the former alone.
    """
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(curve.amounts)))])
    strain = moved / (moved[-1] or 1.0)
    times = curve.times
    if not np.isfinite(times).all() or times[-1] <= times[0]:
        return np.asarray(strain)
    return np.asarray(0.5 * strain + 0.5 * (times - times[0]) / (times[-1] - times[0]))


def _thinned(curve: Curve, arc: FloatArray, share: int) -> IntArray:
    measured = np.flatnonzero(np.isfinite(curve.stress))
    # Stress is measured from the state of rest, whose row is zero by definition.
    rows = measured[(np.abs(curve.strains[measured]) > 0) | (np.abs(curve.stress[measured]) > 0)]
    if len(rows) <= share:
        return np.asarray(rows)
    places = np.interp(np.linspace(0.0, 1.0, share), _with_count(arc[rows]), np.arange(len(rows)))
    return np.asarray(rows[np.unique(np.round(places).astype(np.int64))])


def _with_count(arc: FloatArray) -> FloatArray:
    """Return the mean (n,) of progress `arc` (n,) and row number, each scaled to 0 to 1: short loadings keep rows."""
    count = np.linspace(0.0, 1.0, len(arc))
    span = float(arc[-1] - arc[0]) or 1.0
    return np.asarray(0.5 * (arc - arc[0]) / span + 0.5 * count)
