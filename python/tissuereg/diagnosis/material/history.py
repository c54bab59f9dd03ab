"""Stress along a curve of a model with an elastic law and memory: the solver's own, at one point, a row a time step."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.material.model import Model
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
from tissuereg.experiment.material_tests import MODES, moduli_of, shear_stress, uniaxial_stress


def stress_of(model: Model, curve: Curve, rows: Sequence[int] | IntArray | None = None) -> FloatArray:
    """Return the nominal stress of a model along a curve, shape (n_rows,), in kPa, compression negative.

    `model`: law and effects of time and history; `curve`: its strains and times are used, its stress is not. Without
    times relaxation and viscosity are left out; `rows`: indices of the rows to return; all where absent. The history
    includes all rows in either case. The stress is NaN where the law has no solution, and after that with memory.
    """
    wanted = slice(None) if rows is None else np.asarray(rows, dtype=np.int64)
    material, behaviour = model.material, model.behaviour
    if behaviour is None:
        stress = shear_stress if curve.mode == "simple-shear" else uniaxial_stress
        return stress(material, curve.amounts[wanted])
    law, moduli = material.core_law(), moduli_of(material)
    history = law.stress_history(MODES[curve.mode], *_from_rest(curve), *moduli, behaviour)
    return history[1:][wanted]


def predicted_stresses(experiment: MaterialExperiment) -> list[FloatArray]:
    """Return the stresses that an experiment's model predicts along its curves.

    Parameters
    ----------
    experiment : MaterialExperiment
        Experiment whose effects are applied, for instance from an ``experiment.extended.toml``.

    Returns
    -------
    list of ndarray of float64
        For each curve, shape (n_rows,): nominal stress of every row, kPa, compression negative; NaN where the law has
        no solution, and with memory from there on.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
    >>> shear = Curve("a", "simple-shear", np.nan, [np.nan] * 3, [0.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    >>> gel = MaterialExperiment("gel", Path("."), tr.Material(3.0, 0.49), None, None, (shear,))
    >>> predicted_stresses(gel)[0].round(4).tolist()
    [0.1007, 0.2013, 0.302]
    """
    model = Model(experiment.material).with_effects(experiment.effects)
    return [stress_of(model, curve) for curve in experiment.curves]


@lru_cache(maxsize=256)
def _from_rest(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Return stretches (or amounts of shear) and times in s of a curve, each (n + 1,), with the state of rest first.

    The time from rest to the first row follows from the curve's strain rate, and is 0 where that is not known. Without
    times no time passes at all.
    """
    rest = 0.0 if curve.mode == "simple-shear" else 1.0
    times = curve.clock if curve.timed else np.zeros(len(curve.amounts))
    lead = 0.0 if math.isnan(curve.rate) else abs(float(curve.strains[0])) / curve.rate
    return np.concatenate([[rest], curve.amounts]), np.concatenate([[times[0] - lead], times])
