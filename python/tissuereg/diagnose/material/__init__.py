"""What a believed law gets wrong in material tests: found, named, proved on held-out data, and corrected.

`diagnose_material` is the whole path: `noise` (what curves do by themselves), `hypothesis` (causes fitted, evidence),
`nulls` (what chance does), `search` (race, proof, groups), `verdict`, `refine` and `deviations` (numbers, and how far
they may lie off), `answer`, `extend`, `report`. One file a cause family in `causes`; the stress of a model along a
curve is `history.stress_of`.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissuereg._arguments import place
from tissuereg.diagnose.material.answer import EXTENDED_FILE, answer_of
from tissuereg.diagnose.material.extend import extended, predicted_stresses
from tissuereg.diagnose.material.report import material_page
from tissuereg.diagnose.material.verdict import Outcome, find_out
from tissuereg.io.atomic import OutputError, atomic_folder
from tissuereg.io.json import write_json
from tissuereg.io.material_experiments import write_material_experiment
from tissuereg.material_experiment import MaterialExperiment

__all__ = ["MaterialDiagnosis", "diagnose_material", "predicted_stresses"]


@dataclass(frozen=True, eq=False)
class MaterialDiagnosis:
    """What was found out about a material test.

    Attributes
    ----------
    answer : dict
        Schema ``tissuereg.diagnosis/1``, of JSON's types.
    experiment : MaterialExperiment
        Believed and measured.
    extended : MaterialExperiment
        With the causes found as effects; the same where none was named.
    outcome : Outcome
        All figures, for further work in Python.
    """

    answer: dict[str, Any]
    experiment: MaterialExperiment
    extended: MaterialExperiment
    outcome: Outcome

    @property
    def verdict(self) -> str:
        """``named``, ``group``, ``consistent`` or ``unexplained``."""
        return str(self.answer["verdict"])

    def to_json(self) -> dict[str, Any]:
        """Return the answer as JSON's types."""
        return self.answer

    def save(self, folder: str | os.PathLike[str], extra: Mapping[str, Any] | None = None) -> Path:
        """Write ``diagnosis.json``, ``experiment.extended.toml`` and ``report.html``, all or none.

        Parameters
        ----------
        folder : path-like
            Files of these names in it are replaced, others stay.
        extra : mapping, optional
            Entries added to the JSON, or put over its own.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        OutputError
            If it cannot be written there.
        """
        out = place("folder", folder, error=OutputError)
        with atomic_folder(out) as draft:
            write_json(draft / "diagnosis.json", {**self.answer, **(extra or {})})
            # Paths in the model lead from the folder's final place.
            write_material_experiment(self.extended, draft / EXTENDED_FILE, seen_from=out)
            (draft / "report.html").write_text(material_page(self, out), encoding="utf-8")
        return out


def diagnose_material(
    experiment: MaterialExperiment, *, seed: int = 0, progress: Callable[[str], None] | None = None
) -> MaterialDiagnosis:
    """Find out what the believed law of a material test gets wrong.

    Parameters
    ----------
    experiment : MaterialExperiment
        From `tissuereg.io.material_experiments.read_material_experiment`, or made in Python.
    seed : int
        Of the simulated nulls; the answer is the same at each call.
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    MaterialDiagnosis
        Answer and extended model.

    Notes
    -----
    Seconds for a few curves; up to half a minute where holds at several rates make relaxation one of the candidates.

    Examples
    --------
    Shear that grows with the cube of its amount, which no neo-Hookean solid does:

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> from tissuereg.material_experiment import Curve, MaterialExperiment
    >>> shear, unknown = np.linspace(0.02, 1.0, 40), np.full(40, np.nan)
    >>> curves = tuple(
    ...     Curve(name, "simple-shear", np.nan, unknown, shear, stiff * (shear + shear**3))
    ...     for name, stiff in (("a", 1.0), ("b", 1.05))
    ... )
    >>> gel = MaterialExperiment("gel", Path("."), tr.Material(3.0, 0.49), None, None, curves)
    >>> [cause["id"] for cause in diagnose_material(gel).answer["causes"]]
    ['stiffening']
    """
    outcome = find_out(experiment, seed, progress or (lambda message: None))
    answer = answer_of(experiment, outcome, seed)
    found = experiment if outcome.refined is None else extended(experiment, outcome.refined.fit)
    return MaterialDiagnosis(answer, experiment, found, outcome)
