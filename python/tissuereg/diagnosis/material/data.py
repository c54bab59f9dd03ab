"""What was measured: thinned rows of every curve that are fitted, and what the curves can show at all."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.diagnosis.causes.base import Scene
from tissuereg.diagnosis.material.model import Model, stress_of
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True, eq=False)
class Data:
    """The n rows (measured points) of all curves that are used in fits, curve after curve.

    `rows`: for each curve, the indices of its rows that are used, or none; `stress` (n,): nominal stress, kPa,
    compression negative; `curve_of` (n,): index of the curve; `level` (n,): size of the stress plus a tenth of the
    curve's peak, kPa, by which relative errors are multiplied; `arc` (n,): progress along the load history, 0 to 1;
    `strain` (n,): strain over the largest of its mode, -1 to 1; `log_rate` (n,): decadic logarithm of the strain rate
    in 1/s; 0 where it is not known.
    """

    curves: tuple[Curve, ...]
    rows: tuple[IntArray, ...]
    stress: FloatArray
    curve_of: IntArray
    level: FloatArray
    arc: FloatArray
    strain: FloatArray
    log_rate: FloatArray

    def names(self, unit: str) -> "np.ndarray[Any, np.dtype[np.str_]]":
        """Return the ``mode``, ``rate`` or ``specimen`` of every row, shape (n,)."""
        return np.array([str(getattr(curve, unit)) for curve in self.curves])[self.curve_of]

    def part(self, kept: BoolArray) -> "Data":
        """Return the data with the rows of a mask (n,); curves without rows contribute nothing."""
        rows = tuple(rows[kept[self.curve_of == i]] for i, rows in enumerate(self.rows))
        columns: tuple[Any, ...] = (self.stress, self.curve_of, self.level, self.arc, self.strain, self.log_rate)
        return Data(self.curves, rows, *(column[kept] for column in columns))

    def modelled(self, model: Model) -> FloatArray:
        """Return the nominal stresses (n,) that a model predicts at the rows, kPa; NaN where it has no solution."""
        pairs = zip(self.curves, self.rows, strict=True)
        return np.concatenate([stress_of(model, curve, rows) for curve, rows in pairs if len(rows)])

    def residual(self, model: Model) -> FloatArray:
        """Return measured minus modelled stresses (n,), kPa."""
        return self.stress - self.modelled(model)


def data_of(experiment: MaterialExperiment, max_rows: int) -> Data:
    """Return rows evenly spaced along each load history, `max_rows` in all, but 12 of a curve in any case."""
    curves = experiment.curves
    share = max(12, max_rows // len(curves))
    largest: dict[str, float] = {}
    for curve in curves:
        largest[curve.mode] = max(largest.get(curve.mode, 0.0), float(np.abs(curve.strains).max()))
    rows, parts = [], []
    for index, curve in enumerate(curves):
        arc = path_arc(curve)
        kept = _thinned(curve, arc, share)
        stress, strain = curve.stress[kept], curve.strains[kept] / largest[curve.mode]
        level = np.abs(stress) + 0.1 * float(np.nanmax(np.abs(curve.stress)))
        rate = 0.0 if np.isnan(curve.rate) else float(np.log10(curve.rate))
        rows.append(kept)
        parts.append((stress, np.full(len(kept), index), level, arc[kept], strain, np.full(len(kept), rate)))
    columns: list[Any] = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Data(curves, tuple(rows), *columns)


def path_arc(curve: Curve) -> FloatArray:
    """Return the progress (n,) along a load history, 0 to 1, in which the path length in strain and time count half."""
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(curve.amounts)))])
    strain, times = moved / (moved[-1] or 1.0), curve.times
    if not np.isfinite(times).all() or times[-1] <= times[0]:
        return np.asarray(strain)
    return np.asarray(0.5 * strain + 0.5 * (times - times[0]) / (times[-1] - times[0]))


def _thinned(curve: Curve, arc: FloatArray, share: int) -> IntArray:
    measured = np.flatnonzero(np.isfinite(curve.stress))
    # Stress is measured from the state of rest, whose row is zero by definition.
    rows = measured[(np.abs(curve.strains[measured]) > 0) | (np.abs(curve.stress[measured]) > 0)]
    if len(rows) <= share:
        return np.asarray(rows)
    # The number of a row counts half, so that short loadings keep rows.
    own, count = arc[rows], np.linspace(0.0, 1.0, len(rows))
    along = 0.5 * (own - own[0]) / (float(own[-1] - own[0]) or 1.0) + 0.5 * count
    places = np.interp(np.linspace(0.0, 1.0, share), along, np.arange(len(rows)))
    return np.asarray(rows[np.unique(np.round(places).astype(np.int64))])


def scene_of(experiment: MaterialExperiment, settings: MaterialSettings = DEFAULT.material) -> Scene:
    """Return the modes and the ranges of strain, time and stress of an experiment's curves."""
    curves, timed = experiment.curves, [curve for curve in experiment.curves if curve.timed]
    bars = np.concatenate([np.zeros(1), *(c.strains for c in curves if c.mode != "simple-shear")])
    steps = np.concatenate([np.zeros(0), *(np.diff(curve.clock) for curve in timed)])
    positive = steps[steps > 0]
    longest = max((float(curve.clock[-1] - curve.clock[0]) for curve in timed), default=0.0)
    rates = [curve.rate for curve in curves if not np.isnan(curve.rate)]
    two_rates = bool(rates) and max(rates) > 1.2 * min(rates)
    held, speeds = zip(*(_pace(curve) for curve in timed), strict=True) if timed else ((), (0.0,))
    peaks = [float(np.nanmax(np.abs(curve.stress))) for curve in curves]
    unloaded = any(_unloaded(curve) for curve in curves)
    return Scene(
        modes=tuple(dict.fromkeys(curve.mode for curve in curves)),
        poisson=float(experiment.material.poisson_array[0]),
        invariant=max(_invariant(curve) for curve in curves),
        two_sided=bool(bars.max() > 0.01 and bars.min() < -0.01),
        paced=bool(timed) and (unloaded or two_rates or any(held)),
        unloaded=unloaded,
        shortest_s=max(float(np.median(positive)) if len(positive) else 0.0, longest * 1e-4),
        longest_s=longest,
        peak=max(peaks),
        peak_energy=max(0.5 * p * float(np.abs(c.strains).max()) for p, c in zip(peaks, curves, strict=True)),
        fastest=max(speeds),
        settings=settings,
    )


def _invariant(curve: Curve) -> float:
    """Return the largest I1 - 3 of a curve, at preserved volume."""
    squared = curve.amounts**2
    return float((squared if curve.mode == "simple-shear" else squared + 2.0 / curve.amounts - 3.0).max())


def _unloaded(curve: Curve) -> bool:
    """Return whether the strain falls below nine tenths of its largest so far; not that of a sweep through zero."""
    strains, moves = curve.strains, np.diff(curve.strains)
    sizes, largest = np.abs(strains), np.maximum.accumulate(np.abs(strains))
    source = np.maximum.accumulate(np.where(sizes >= largest, np.arange(len(sizes)), 0))
    falls = (sizes < 0.9 * largest) & (np.sign(strains) == np.sign(strains[source]))
    sweeps = ((moves >= 0).all() or (moves <= 0).all()) and strains.min() < 0 < strains.max()
    return bool(falls.any() and not sweeps)


def _pace(curve: Curve) -> tuple[bool, float]:
    """Return whether the strain is held for more than a tenth of the time, and its largest rate, 1/s."""
    steps, moves = np.diff(curve.clock), np.abs(np.diff(curve.strains))
    still, moving = moves < 1e-3 * np.abs(curve.strains).max(), steps > 0
    fastest = float(np.quantile(moves[moving] / steps[moving], 0.95)) if moving.any() else 0.0
    return bool(steps[still].sum() > 0.1 * steps.sum()), fastest
