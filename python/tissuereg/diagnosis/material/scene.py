"""The modes, strains, times and unloading of a set of curves, which decide what causes can be observed."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True)
class Scene:
    """Tested modes and ranges of a set of curves, which set the priors and decide what causes can be observed.

    Attributes
    ----------
    modes : tuple of str
        Tested modes.
    poisson : float
        Believed Poisson's ratio.
    invariant : float
        Largest ``I1 - 3``, with I1 the first invariant of the right Cauchy-Green tensor at preserved volume.
    pulled, pushed : bool
        Whether a bar was stretched and compressed, each by more than 1 %.
    timed : bool
        Whether times or rates are known.
    paced : bool
        Whether effects of time can be distinguished from those of strain: holds, unloading, or two rates that differ by
        a fifth.
    unloaded : bool
        Whether the strain falls below nine tenths of its largest so far.
    shortest_s, longest_s : float
        Range of time constants that the curves can resolve, s.
    peak : float
        Largest stress, kPa.
    peak_energy : float
        Half the largest stress times its strain, kPa.
    fastest : float
        Largest rate of strain, 1/s; 0 where times are not known.
    settings : MaterialSettings
        Priors of the causes.
    """

    modes: tuple[str, ...]
    poisson: float
    invariant: float
    pulled: bool
    pushed: bool
    timed: bool
    paced: bool
    unloaded: bool
    shortest_s: float
    longest_s: float
    peak: float
    peak_energy: float
    fastest: float
    settings: MaterialSettings = DEFAULT.material

    @property
    def two_sided(self) -> bool:
        """Whether tension and compression were both tested."""
        return self.pulled and self.pushed


def scene_of(experiment: MaterialExperiment, settings: MaterialSettings = DEFAULT.material) -> Scene:
    """Return the modes and the ranges of strain, time and stress of an experiment's curves."""
    curves = experiment.curves
    bars = np.concatenate([np.zeros(1), *(c.strains for c in curves if c.mode != "simple-shear")])
    timed = [curve for curve in curves if curve.timed]
    steps = np.concatenate([np.zeros(0), *(np.diff(curve.clock) for curve in timed)])
    lengths = [float(curve.clock[-1] - curve.clock[0]) for curve in timed]
    longest = max(lengths, default=0.0)
    positive = steps[steps > 0]
    rates = {curve.rate for curve in curves if not np.isnan(curve.rate)}
    peaks = [float(np.nanmax(np.abs(curve.stress))) for curve in curves]
    energies = [0.5 * p * float(np.abs(c.strains).max()) for p, c in zip(peaks, curves, strict=True)]
    unloaded = any(_unloaded(curve) for curve in curves)
    return Scene(
        modes=tuple(dict.fromkeys(curve.mode for curve in curves)),
        poisson=float(experiment.material.poisson_array[0]),
        invariant=max(float(_invariant(curve).max()) for curve in curves),
        pulled=bool(bars.max() > 0.01),
        pushed=bool(bars.min() < -0.01),
        timed=bool(timed) and longest > 0,
        paced=bool(timed) and (unloaded or _two_paces(rates) or any(_holds(curve) for curve in timed)),
        unloaded=unloaded,
        shortest_s=max(float(np.median(positive)) if len(positive) else 0.0, longest * 1e-4),
        longest_s=longest,
        peak=max(peaks),
        peak_energy=max(energies),
        settings=settings,
        fastest=max((_fastest(curve) for curve in timed), default=0.0),
    )


def _invariant(curve: Curve) -> FloatArray:
    if curve.mode == "simple-shear":
        return np.asarray(curve.amounts**2)
    return np.asarray(curve.amounts**2 + 2.0 / curve.amounts - 3.0)


def _unloaded(curve: Curve) -> bool:
    sizes = np.abs(curve.strains)
    falls = sizes < 0.9 * np.maximum.accumulate(sizes)
    # A sweep from tension through zero to compression is no unloading.
    return bool((falls & (np.sign(curve.strains) == np.sign(_of_largest(curve)))).any()) and not _sweeps(curve)


def _of_largest(curve: Curve) -> FloatArray:
    sizes = np.abs(curve.strains)
    source = np.maximum.accumulate(np.where(sizes >= np.maximum.accumulate(sizes), np.arange(len(sizes)), 0))
    return np.asarray(curve.strains[source])


def _sweeps(curve: Curve) -> bool:
    moves = np.diff(curve.strains)
    return bool((moves >= 0).all() or (moves <= 0).all()) and curve.strains.min() < 0 < curve.strains.max()


def _holds(curve: Curve) -> bool:
    steps, moves = np.diff(curve.clock), np.abs(np.diff(curve.strains))
    still = moves < 1e-3 * np.abs(curve.strains).max()
    return bool(steps[still].sum() > 0.1 * steps.sum())


def _two_paces(rates: set[float]) -> bool:
    return len(rates) > 1 and max(rates) > 1.2 * min(rates)


def _fastest(curve: Curve) -> float:
    steps, moves = np.diff(curve.clock), np.abs(np.diff(curve.strains))
    moving = steps > 0
    return float(np.quantile(moves[moving] / steps[moving], 0.95)) if moving.any() else 0.0
