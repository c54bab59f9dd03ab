"""Diagnosis of material tests: which causes explain the difference between measured stress curves and a believed law.

The steps are in `verdict`, what all fits share in `bench`; rounds of the search, evidence and records of the answer
are those of bodies. ``docs/material.md`` describes the method.
"""

from collections.abc import Callable

from tissuereg.diagnosis.material.answer import MaterialDiagnosis
from tissuereg.diagnosis.material.model import predicted_stresses
from tissuereg.diagnosis.material.verdict import diagnosis_of
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.experiment.material_experiment import MaterialExperiment

__all__ = ["MaterialDiagnosis", "diagnose_material", "predicted_stresses"]


def diagnose_material(
    experiment: MaterialExperiment,
    *,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    settings: DiagnoseSettings = DEFAULT,
) -> MaterialDiagnosis:
    """Return the diagnosis of a material test.

    Parameters
    ----------
    experiment : MaterialExperiment
        Believed law and measured curves, from `tissuereg.io.material_experiments.read_material_experiment` or made in
        Python.
    seed : int
        Seed of the simulated null experiments; the result is the same at each call.
    progress : callable, optional
        Called with the name of the step that begins.
    settings : DiagnoseSettings
        All numbers that may change the result.

    Returns
    -------
    MaterialDiagnosis
        Answer and extended model.

    Notes
    -----
    Takes seconds for a few curves, and up to half a minute where holds at several rates make relaxation a candidate.

    Examples
    --------
    A shear stress with a cubic term, which no neo-Hookean solid has:

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
    >>> shear, unknown = np.linspace(0.02, 1.0, 40), np.full(40, np.nan)
    >>> curves = tuple(
    ...     Curve(name, "simple-shear", np.nan, unknown, shear, stiff * (shear + shear**3))
    ...     for name, stiff in (("a", 1.0), ("b", 1.05))
    ... )
    >>> gel = MaterialExperiment("gel", Path("."), tr.Material(3.0, 0.49), None, None, curves)
    >>> [finding.id for finding in diagnose_material(gel).findings]
    ['stiffening']
    """
    return diagnosis_of(experiment, seed, progress or (lambda message: None), settings)
