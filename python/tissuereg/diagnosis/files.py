"""The folder of a diagnosis: answer, extended model and report, written whole or not at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg.diagnosis.report.page import write_report
from tissuereg.io.atomic import atomic_folder
from tissuereg.io.experiment_out import write_experiment
from tissuereg.io.json import write_json

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import Diagnosis


def write_diagnosis(found: "Diagnosis", out: Path, extra: Mapping[str, Any]) -> Path:
    """Write ``diagnosis.json``, ``experiment.extended.toml`` and ``report.html``.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    out : Path
        Folder; files of these names in it are replaced, others stay.
    extra : mapping
        Entries added to the JSON, or replacing its own.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ExperimentError
        If the extended model cannot be written as a file (`tissuereg.io.experiment_out.write_experiment`).
    OutputError
        If the folder cannot be written.
    """
    with atomic_folder(out) as folder:
        write_json(folder / "diagnosis.json", {**found.to_json(), **extra})
        # Paths in the model are relative to the final folder.
        write_experiment(found.extended, folder / "experiment.extended.toml", seen_from=out)
        write_report(found, folder / "report.html", seen_from=out)
    return out
