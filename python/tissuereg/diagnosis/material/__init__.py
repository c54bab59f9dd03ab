"""Diagnosis of material tests: which causes explain the difference between measured stress curves and a believed law.

`diagnose_material` runs all steps: `noise` (measurement error of the curves), `hypothesis` (fits of causes and their
evidence), `nulls` (threshold and p-value from simulated null experiments), `search` (selection of causes, held-out
proof, groups), `verdict`, `refine` (form, weights and standard deviations of the reported fit), `answer` and
`report`. `causes` is the catalogue; `history.stress_of` computes the stress of a model along a curve.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissuereg.diagnosis.answer import save_answer
from tissuereg.diagnosis.material.answer import answer_of
from tissuereg.diagnosis.material.fit import extended
from tissuereg.diagnosis.material.history import predicted_stresses
from tissuereg.diagnosis.material.report import material_page
from tissuereg.diagnosis.material.verdict import SelectionOutcome, find_out
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.experiment.material_experiment import MaterialExperiment

__all__ = ["MaterialDiagnosis", "diagnose_material", "predicted_stresses"]


@dataclass(frozen=True, eq=False)
class MaterialDiagnosis:
    """The result of a diagnosis of a material test.

    Attributes
    ----------
    answer : dict
        The answer in JSON's types, by the schema ``tissuereg.diagnosis/1``.
    experiment : MaterialExperiment
        Believed law and measured curves.
    extended : MaterialExperiment
        The experiment with the causes found as effects; the same as `experiment` where none was named.
    outcome : SelectionOutcome
        All intermediate results, for further work in Python.
    """

    answer: dict[str, Any]
    experiment: MaterialExperiment
    extended: MaterialExperiment
    outcome: SelectionOutcome

    @property
    def verdict(self) -> str:
        """Verdict of the answer: ``named``, ``group``, ``consistent`` or ``unexplained``."""
        return str(self.answer["verdict"])

    def to_json(self) -> dict[str, Any]:
        """Return the answer, a dictionary of JSON's types by the schema ``tissuereg.diagnosis/1``."""
        return self.answer

    def save(self, folder: str | os.PathLike[str], extra: Mapping[str, Any] | None = None) -> Path:
        """Write answer, extended model and report into a folder, as `Diagnosis.save` does for bodies."""
        answer = {**self.answer, **(extra or {})}
        return save_answer(folder, answer, self.extended, lambda out: material_page(self, out))


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
    >>> [cause["id"] for cause in diagnose_material(gel).answer["causes"]]
    ['stiffening']
    """
    outcome = find_out(experiment, seed, progress or (lambda message: None), settings)
    answer = answer_of(experiment, outcome, seed)
    found = experiment if outcome.refined is None else extended(experiment, outcome.refined.fit)
    return MaterialDiagnosis(answer, experiment, found, outcome)
