"""The folder of a simulated experiment: an experiment of the same rig with simulated tables, and displacements."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tissuereg._base.arrays import FloatArray
from tissuereg.experiment.experiment import Experiment, Simulated
from tissuereg.io.atomic import atomic_folder
from tissuereg.io.cases import write_histories
from tissuereg.io.experiment_keys import (
    ACTUATORS_CSV,
    APPLIED_CSV,
    CSV_TABLES,
    FORCES_CSV,
    MARKERS_CSV,
    TARGETS_CSV,
    CsvTable,
)
from tissuereg.io.experiment_out import write_experiment
from tissuereg.io.npz import write_npz

if TYPE_CHECKING:
    from tissuereg.simulation.experiment import CaseSimulation

#: Files that are written in addition to the fields; tables without rows are left out.
TABLES = ("experiment.toml", *(table.file for table in CSV_TABLES))

#: Values by name in the frames of every case, with their times.
_Histories = dict[str, tuple[FloatArray, dict[str, FloatArray]]]


def write_simulated(
    out: Path, experiment: Experiment, answers: "Mapping[str, CaseSimulation]", model: Simulated
) -> None:
    """Write a simulated experiment, all or nothing.

    Parameters
    ----------
    out : Path
        Folder to write.
    experiment : Experiment
        What was simulated; its mesh stays where it is.
    answers : mapping of str to CaseSimulation
        All cases.
    model : Simulated
        The model that was used; the experiment file states it.

    Raises
    ------
    ExperimentError
        If a belief cannot be written to an experiment file.
    OutputError
        If the folder cannot be written.
    """
    with atomic_folder(out) as folder:
        # Paths are those seen from where the folder will be.
        described = replace(experiment, folder=out, simulated=model)
        write_experiment(described, folder / "experiment.toml", seen_from=out)
        for table, histories in simulated_tables(experiment, answers):
            write_histories(folder / table.file, table, histories)
        for number, (case, answer) in enumerate(answers.items()):
            arrays = {"time_s": answer.times, "displacement_mm": answer.displacement}
            write_npz(folder / f"case_{_file_word(case, number)}.npz", arrays)


def simulated_tables(
    experiment: Experiment, answers: "Mapping[str, CaseSimulation]"
) -> list[tuple[CsvTable, _Histories]]:
    """Return the tables of an experiment folder with simulated values; tables without a row are left out.

    Parameters
    ----------
    experiment : Experiment
        What was simulated.
    answers : mapping of str to CaseSimulation
        All cases.

    Returns
    -------
    list of (CsvTable, mapping)
        As `write_histories` takes them.
    """
    names = experiment.marker_names
    cases = experiment.cases
    tables: list[tuple[CsvTable, _Histories]] = [
        (MARKERS_CSV, {c: (a.times, {n: a.markers[:, i] for i, n in enumerate(names)}) for c, a in answers.items()}),
        # `read_experiment` refuses forces without a stated noise.
        (FORCES_CSV, {c: (a.times, a.forces) for c, a in answers.items() if experiment.force_std is not None}),
        (TARGETS_CSV, {c: (a.times, a.targets) for c, a in answers.items()}),
        (ACTUATORS_CSV, {name: (case.times, dict(case.displacements)) for name, case in cases.items()}),
        (APPLIED_CSV, {name: (case.times, dict(case.applied_forces)) for name, case in cases.items()}),
    ]
    filled = [(table, {case: rows for case, rows in histories.items() if rows[1]}) for table, histories in tables]
    return [(table, histories) for table, histories in filled if histories]


def _file_word(case: str, number: int) -> str:
    plain = all(letter.isalnum() or letter in "-_" for letter in case)
    return case if plain else str(number)
