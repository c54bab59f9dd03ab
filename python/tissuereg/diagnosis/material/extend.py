"""The extended model: the believed experiment with the findings as effects, which can be read and run."""

from dataclasses import replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.fit import MaterialFit
from tissuereg.diagnosis.material.history import stress_of
from tissuereg.diagnosis.material.model import model_of
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import OtherLaw
from tissuereg.experiment.material_experiment import MaterialExperiment


def extended(experiment: MaterialExperiment, fit: MaterialFit) -> MaterialExperiment:
    """Return an experiment with the causes found as its effects.

    Parameters
    ----------
    experiment : MaterialExperiment
        The believed experiment.
    fit : MaterialFit
        Fit of the causes found.

    Returns
    -------
    MaterialExperiment
        The experiment in which each new effect replaces an older one of the same id, or an older law; Young's modulus
        is the fitted one, unless it is itself a finding.
    """
    found = fit.effects
    kept = [old for old in experiment.effects if not any(_same_kind(old, new) for new in found)]
    changed = replace(experiment, effects=(*kept, *found))
    if any(effect.id == "stiffness" for effect in changed.effects):
        return changed
    young = float(np.exp(fit.x[0]))
    std = young * float(np.sqrt(fit.covariance[0, 0]))
    return replace(changed, material=replace(experiment.material, young=young), young_std=std)


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
        no solution.

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
    model = model_of(experiment)
    return [stress_of(model, curve) for curve in experiment.curves]


def _same_kind(one: Effect, other: Effect) -> bool:
    return one.id == other.id or (isinstance(one, OtherLaw) and isinstance(other, OtherLaw))
