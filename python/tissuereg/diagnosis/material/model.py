"""The model of a material test, an elastic law with memory, and its stress along a curve: the solver's at one point."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, cast

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.material import Material
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.history import Memory
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
from tissuereg.experiment.material_tests import MODES, moduli_of, shear_stress, uniaxial_stress
from tissuereg.simulation.memory import behaviour_of


@dataclass(frozen=True, eq=False)
class Model:
    """A law with instantaneous moduli, `material`, and effects of time and load history by id, its `memory`."""

    material: Material
    memory: Mapping[str, Memory] = field(default_factory=dict)

    def with_young(self, young: float) -> "Model":
        """Return the model with another Young's modulus, kPa."""
        return replace(self, material=replace(self.material, young=young))

    def with_effects(self, effects: Iterable[Effect]) -> "Model":
        """Return the model with effects on moduli, law, fibres or memory applied; others raise `ExperimentError`."""
        model = self
        for effect in effects:
            if not effect.of_specimen:
                message = f"an effect of a material test must be one on the material, got '{effect.id}'"
                raise ExperimentError(message, where=effect.id)
            if isinstance(effect, Memory):
                model = replace(model, memory={**model.memory, effect.id: effect})
            else:
                # Others change the field `material` alone, of an experiment as of this record.
                model = cast("Model", effect.applied(cast("Any", model), "tet4"))
        return model


def stress_of(model: Model, curve: Curve, rows: Sequence[int] | IntArray | None = None) -> FloatArray:
    """Return the nominal stress (n_rows,), kPa, of a model along a curve, at some of its rows or all.

    Without times relaxation and viscosity are left out. The stress is NaN where the law has no solution, and with
    memory from there on, as the history includes all rows in either case.
    """
    wanted = slice(None) if rows is None else np.asarray(rows, dtype=np.int64)
    material, behaviour = model.material, behaviour_of(model.memory.values())
    if behaviour is None:
        stress = shear_stress if curve.mode == "simple-shear" else uniaxial_stress
        return stress(material, curve.amounts[wanted])
    path, moduli = _from_rest(curve), moduli_of(material)
    history = material.core_law().stress_history(MODES[curve.mode], *path, *moduli, behaviour.core())
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
    """Return stretches (or amounts of shear) and times in s of a curve, each (n + 1,), with the state of rest first."""
    rest = 0.0 if curve.mode == "simple-shear" else 1.0
    times = curve.clock if curve.timed else np.zeros(len(curve.amounts))
    # The time from rest to the first row is that of the strain rate, where it is known.
    lead = 0.0 if math.isnan(curve.rate) else abs(float(curve.strains[0])) / curve.rate
    return np.concatenate([[rest], curve.amounts]), np.concatenate([[times[0] - lead], times])
