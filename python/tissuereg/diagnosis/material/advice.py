"""Which further test would distinguish two causes that the measured curves cannot."""

from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes.base import Scene
from tissuereg.diagnosis.material.data import data_of
from tissuereg.diagnosis.material.history import stress_of
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.material.noise import CurveNoise, covariance
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.errors import ExperimentError
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True)
class Advice:
    """A further test that would distinguish two causes, and its expected benefit.

    `action`: description of the test in words; `separability`: norm of the difference between the stresses that the two
    causes predict for it, in standard deviations of the noise.
    """

    action: str
    separability: float


def best_test(
    experiment: MaterialExperiment,
    scene: Scene,
    one: Model,
    other: Model,
    settings: MaterialSettings = DEFAULT.material,
) -> Advice | None:
    """Return the further test, of a list of usual ones, that distinguishes two fitted models best.

    `experiment`: the curves measured so far; `scene`: tested modes and ranges; `one`, `other`: models fitted to these
    curves. Result: None where no test has finite stresses under both models.
    """
    tests = []
    for action, curve in _stock(experiment, scene, settings.advised_rows):
        first, second = (stress_of(model, curve) for model in (one, other))
        if np.isfinite(first).all() and np.isfinite(second).all():
            tests.append(Advice(action, _separability(experiment, curve, first, second, settings)))
    return max(tests, key=lambda advice: advice.separability, default=None)


def _separability(
    experiment: MaterialExperiment, curve: Curve, first: FloatArray, second: FloatArray, settings: MaterialSettings
) -> float:
    """Return the norm of the difference between two predicted stress curves, in standard deviations of the noise.

    `curve`: load history; `first`, `second` (n,): predictions, kPa. The noise is that of one more specimen. The norm is
    0 where `first` is not a valid stress curve.
    """
    try:
        measured = replace(curve, stress=first)
    except ExperimentError:
        return 0.0
    data = data_of(replace(experiment, curves=(measured,)), settings.most_rows)
    noise = CurveNoise(np.array([0.005 * float(np.abs(first).max())]), settings.usual_factor, settings.usual_along, 0)
    own = covariance(data, noise, settings) + settings.usual_factor**2 * np.outer(data.stress, data.stress)
    difference = (first - second)[data.rows[0]]
    return float(np.sqrt(difference @ np.linalg.solve(own, difference)))


def _stock(experiment: MaterialExperiment, scene: Scene, n_rows: int) -> list[tuple[str, Curve]]:
    curves = experiment.curves
    bars = [float(np.abs(c.strains).max()) for c in curves if c.mode != "simple-shear"]
    shears = [float(np.abs(c.strains).max()) for c in curves if c.mode == "simple-shear"]
    bar = min(max(bars), 0.6) if bars else min(0.5 * max(shears), 0.3)
    shear = max(shears) if shears else 1.5 * bar
    largest = {"tension": bar, "compression": -bar, "simple-shear": shear}
    rate = min((c.rate for c in curves if not np.isnan(c.rate)), default=0.01)
    tests: list[tuple[str, Curve]] = []

    def add(action: str, mode: str, path: tuple[FloatArray, FloatArray]) -> None:
        times, strains = path
        amounts = strains if mode == "simple-shear" else 1.0 + strains
        # The stress is a placeholder of the right sign: the models use the path alone.
        tests.append((action, Curve("next", mode, rate, times, amounts, strains)))

    for mode, far in largest.items():
        if mode not in scene.modes:
            add(f"{mode.replace('-', ' ')} to a strain of {abs(far):.2g}", mode, _ramp(far, rate, n_rows))
    first = scene.modes[0]
    named, far = first.replace("-", " "), largest[first]
    add(f"{named} with a hold of {10 * abs(far) / rate:.3g} s", first, _hold(far, rate, n_rows))
    add(f"{named} ten times as fast", first, _ramp(far, 10.0 * rate, n_rows))
    add(f"{named}, unloaded and loaded again", first, _again(far, rate, n_rows))
    for mode in scene.modes:
        wide = min(1.5 * abs(largest[mode]), 0.7) if mode == "compression" else 1.5 * abs(largest[mode])
        further = float(np.sign(largest[mode])) * wide
        add(f"{mode.replace('-', ' ')} to a strain of {wide:.2g}", mode, _ramp(further, rate, n_rows))
    return tests


def _ramp(largest: float, rate: float, n_rows: int) -> tuple[FloatArray, FloatArray]:
    strains = np.linspace(0.0, largest, n_rows)
    return np.abs(strains) / rate, strains


def _hold(largest: float, rate: float, n_rows: int) -> tuple[FloatArray, FloatArray]:
    times, strains = _ramp(largest, rate, n_rows)
    later = times[-1] * (1.0 + np.geomspace(0.05, 10.0, n_rows))
    return np.concatenate([times, later]), np.concatenate([strains, np.full(n_rows, largest)])


def _again(largest: float, rate: float, n_rows: int) -> tuple[FloatArray, FloatArray]:
    up = np.linspace(0.0, largest, n_rows)
    strains = np.concatenate([up, up[-2::-1], up[1:]])
    return np.cumsum(np.abs(np.diff(strains, prepend=0.0))) / rate, strains
