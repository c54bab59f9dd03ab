"""What all fits to a material test share: believed model, rows, covariances, and the rows that are held out in turn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.fit import FittedCause, effects_of
from tissuereg.diagnosis.material.data import Data, data_of
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.material.noise import CurveNoise, Weights, covariance, generic_covariance, noise_of, weights_of
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, MaterialSettings
from tissuereg.experiment.effects.elastic import Stiffness
from tissuereg.experiment.material_experiment import HELD_OUT, MaterialExperiment


@dataclass(frozen=True, eq=False)
class CurveBench:
    """Data, covariances and believed model of all fits to a material test, and the rows held out to prove them.

    `base`: the believed model; `data`: the n rows (measured points) that are fitted; `young_log`, `young_std`: prior
    mean and standard deviation of the logarithm of Young's modulus in kPa; `noise`, `generic` (n, n): covariances of
    the curves' errors and of a generic misfit (a smooth Gaussian process) of size 1 over the stress, kPa^2; `fitting`
    (n, n): covariance that weights the fits, kPa^2, and `weights`, the whitening by it; `errors`: noise of the curves,
    from which `noise` follows; `unit`: what is held out: a ``mode``, a ``rate``, a ``specimen``, or the last ``part``
    of the curves; `blocks`: by name, a mask (n,) of the rows that are held out together.
    """

    base: Model
    data: Data
    young_log: float
    young_std: float
    noise: FloatArray
    generic: FloatArray
    fitting: FloatArray
    weights: Weights
    errors: CurveNoise
    unit: str
    blocks: dict[str, BoolArray]
    settings: DiagnoseSettings

    def model(self, parts: Sequence[FittedCause], x: FloatArray) -> Model:
        """Return the believed model with causes at `x` (n,): log of Young's modulus in kPa, then their parameters."""
        young = float(np.exp(np.clip(x[0], -30.0, 30.0)))
        effects = effects_of(parts, x, young)
        return self.base.with_young(young).with_effects(one for one in effects if not isinstance(one, Stiffness))

    def prior(self, parts: Sequence[FittedCause]) -> tuple[FloatArray, FloatArray]:
        """Return prior mean and standard deviation, each (n,), of the log modulus (kPa) and each cause's parameters."""
        wide = any(part.id == "stiffness" for part in parts)
        of_young = self.settings.material.wide_young if wide else self.young_std
        mean = np.concatenate([[self.young_log], *(part.free_parameters.mean for part in parts)])
        return mean, np.concatenate([[of_young], *(part.free_parameters.deviation for part in parts)])


def bench_of(experiment: MaterialExperiment, settings: DiagnoseSettings = DEFAULT) -> CurveBench:
    """Return the bench of an experiment, on which all rows are weighted by the noise."""
    numbers = settings.material
    data, errors = data_of(experiment, numbers.most_rows), noise_of(experiment, numbers)
    own, generic = covariance(data, errors, numbers), generic_covariance(data, numbers)
    base = Model(experiment.material).with_effects(experiment.effects)
    young = float(base.material.young_array[0])
    std = numbers.young_spread if experiment.young_std is None else math.log1p(experiment.young_std / young)
    weights, held_out = weights_of(own, generic), _blocks(experiment, data, numbers)
    return CurveBench(base, data, math.log(young), std, own, generic, own, weights, errors, *held_out, settings)


def _blocks(experiment: MaterialExperiment, data: Data, settings: MaterialSettings) -> tuple[str, dict[str, BoolArray]]:
    """Return what is held out, as stated or the first unit with several values, and the rows of each block by name."""
    for unit in HELD_OUT if experiment.hold_out is None else (experiment.hold_out,):
        values = experiment.values(unit)
        sets = _alike(values, settings.same_rate) if unit == "rate" else [[value] for value in values]
        if len(sets) > 1:
            if unit == "specimen" and len(values) > settings.most_folds:
                sets = [values[i :: settings.most_folds] for i in range(settings.most_folds)]
            names = [", ".join(f"{float(one):g}/s" if unit == "rate" else str(one) for one in each) for each in sets]
            masks = [np.isin(data.names(unit), [str(one) for one in each]) for each in sets]
            return unit, dict(zip(names, masks, strict=True))
    return "part", {"the last part of the load history": data.arc > settings.part}


def _alike(rates: Sequence[str | float], same: float) -> list[list[str | float]]:
    """Return strain rates (1/s) in ascending order, in sets of which each rate is below `same` times the one before."""
    sets: list[list[str | float]] = []
    for rate in sorted(float(rate) for rate in rates):
        if not sets or rate >= same * float(sets[-1][-1]):
            sets.append([])
        sets[-1].append(rate)
    return sets
