"""Writing of experiments: a file that refers to the mesh and tables of another folder, or a whole simulated folder."""

import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.arguments import of_kind, place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Actuator, Boundary, Experiment, Simulated
from tissuereg.experiment.material_experiment import MaterialExperiment
from tissuereg.io.atomic import OutputError, atomic_folder
from tissuereg.io.cases import write_histories
from tissuereg.io.experiment_keys import (
    ACTUATORS_CSV,
    APPLIED_CSV,
    CSV_TABLES,
    FORCES_CSV,
    MARKERS_CSV,
    TARGETS_CSV,
    CsvTable,
    material_table,
)
from tissuereg.io.fields import write_npz
from tissuereg.io.simulated import tables_sha256
from tissuereg.io.toml_text import toml_text, write_toml

if TYPE_CHECKING:
    from tissuereg.simulation.experiment import CaseSimulation


def write_experiment(
    experiment: Experiment | MaterialExperiment,
    path: str | os.PathLike[str],
    *,
    seen_from: str | os.PathLike[str] | None = None,
) -> None:
    """Write an experiment file that `read_experiment` or `read_material_experiment` reads back, effects included.

    Mesh and comma-separated tables stay where they are; the file refers to them by paths relative to itself.

    Parameters
    ----------
    experiment : Experiment or MaterialExperiment
        An experiment read from files. Its material, noise and effects may have been changed since, its cases and
        patches of nodes not.
    path : path-like
        The file, for example ``experiment.extended.toml``; an older one is replaced as a whole.
    seen_from : path-like, optional
        Folder in which the file will be read, if it is written elsewhere first; need not exist. By default that of
        `path`.

    Raises
    ------
    ExperimentError
        If a value cannot stand in such a file: a modulus per tet, fibres in the material, a patch without a rule.
    OutputError
        If the file cannot be written there.
    """
    of_kind("experiment", experiment, (Experiment, MaterialExperiment), error=ExperimentError)
    path = place("path", path, error=OutputError)
    write_toml(path, _content(experiment, path.parent if seen_from is None else Path(seen_from)))


def experiment_text(experiment: Experiment | MaterialExperiment, folder: str | os.PathLike[str]) -> str:
    """Return the TOML text of an experiment file, the same that `write_experiment` writes.

    `folder`: folder in which the file is to be read, to which its paths refer; need not exist. Raises `ExperimentError`
    if a value of the experiment cannot stand in an experiment file.
    """
    return toml_text(_content(experiment, Path(folder)))


def _content(experiment: Experiment | MaterialExperiment, folder: Path) -> dict[str, Any]:
    content = (
        _of_test(experiment, folder) if isinstance(experiment, MaterialExperiment) else _of_rig(experiment, folder)
    )
    content["effect"] = [effect.table() for effect in experiment.effects]
    return {key: value for key, value in content.items() if value != []}


def _of_test(experiment: MaterialExperiment, folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = {"kind": "material-test", "name": experiment.name, **_tables(experiment, folder)}
    content["material"] = material_table(experiment.material, experiment.young_std, experiment.poisson_std)
    test = {"hold_out": experiment.hold_out, "std_kpa": experiment.stress_std}
    content["test"] = {key: value for key, value in test.items() if value is not None} or []
    return content


def _tables(experiment: Experiment | MaterialExperiment, folder: Path) -> dict[str, str]:
    """Return the entry ``tables`` of an experiment file: the folder of its comma-separated tables, as a relative path.

    `folder`: folder in which the file is to be read. Result: an empty dict if the tables lie in this folder.
    """
    return {} if _same(folder, experiment.folder) else {"tables": path_from(folder, experiment.folder)}


def _of_rig(experiment: Experiment, folder: Path) -> dict[str, Any]:
    material = experiment.material
    if material.fibre is not None:
        message = "fibres of an experiment file must be an effect, got them in the material"
        raise ExperimentError(message, where="fibre")
    content: dict[str, Any] = {"name": experiment.name, **_tables(experiment, folder)}
    content["mesh"] = {"file": path_from(folder, experiment.mesh_file)}
    if experiment.surface_std:
        content["mesh"]["surface_std_mm"] = experiment.surface_std
    if experiment.surface_length is not None:
        content["mesh"]["surface_length_mm"] = experiment.surface_length
    content["material"] = material_table(material, experiment.young_std, experiment.poisson_std)
    gravity = experiment.gravity
    if gravity is not None:
        content["gravity"] = {
            "direction": gravity.direction.tolist(),
            "g_mm_per_s2": gravity.g_mm_per_s2,
            "in_reference": gravity.in_reference,
        }
    if experiment.force_std is not None:
        content["forces"] = {"std_mN": experiment.force_std}
    content["markers"] = _markers(experiment)
    if experiment.simulated is not None:
        stated = asdict(experiment.simulated)
        content["simulated"] = {key: value for key, value in stated.items() if value is not None}
    content["boundary"] = [_patch(boundary) for boundary in experiment.boundaries]
    content["actuator"] = [{**_patch(actuator), "contact": actuator.contact} for actuator in experiment.actuators]
    content["target"] = [{"name": name, "reference": place.tolist()} for name, place in experiment.targets.items()]
    return content


def _markers(experiment: Experiment) -> dict[str, Any]:
    places = zip(experiment.marker_names, experiment.marker_reference.tolist(), strict=True)
    markers: dict[str, Any] = {"std_mm": experiment.marker_std, "reference": dict(places)}
    if experiment.trial_share:
        markers = {"trial_share": experiment.trial_share, **markers}
    return markers if experiment.rest_case is None else {"rest_case": experiment.rest_case, **markers}


def _patch(patch: Boundary | Actuator) -> dict[str, Any]:
    if patch.rule is None:
        message = f"a patch in an experiment file must have a rule for its nodes; '{patch.name}' has nodes alone"
        raise ExperimentError(message, where=patch.name)
    stated = {} if patch.edge_std is None else {"edge_std_mm": patch.edge_std}
    return {"name": patch.name, "nodes": patch.rule, "kind": patch.kind, **stated}


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def path_from(folder: Path, place: Path) -> str:
    """Return a path relative to a folder, links resolved, with forward slashes; the absolute one on another drive."""
    try:
        return Path(os.path.relpath(os.path.realpath(place), os.path.realpath(folder))).as_posix()
    except ValueError:
        return place.absolute().as_posix()


#: Files that are written in addition to the fields; tables without rows are left out.
TABLES = ("experiment.toml", *(table.file for table in CSV_TABLES))

#: Values by name in the frames of every case, with their times.
_Histories = dict[str, tuple[FloatArray, dict[str, FloatArray]]]


def write_simulated(
    out: Path, experiment: Experiment, answers: "Mapping[str, CaseSimulation]", model: Simulated
) -> None:
    """Write the folder of a simulated experiment, whole or not at all: experiment file, tables and displacements.

    `out`: folder to write; `experiment`: the experiment that was simulated; its mesh stays where it is; `answers`: the
    simulation of each case by the case's name, whose displacement (n_frames, n_nodes, 3) in mm goes into an .npz file
    per case; `model`: the model that was used; the experiment file states it. Raises `ExperimentError` if a value of
    the experiment cannot stand in an experiment file; `OutputError` if the folder cannot be written.
    """
    with atomic_folder(out) as folder:
        for table, histories in simulated_tables(experiment, answers):
            write_histories(folder / table.file, table, histories)
        stated = replace(model, tables_sha256=tables_sha256(folder, experiment.mesh_file))
        # Paths are those seen from where the folder will be.
        described = replace(experiment, folder=out, simulated=stated)
        write_experiment(described, folder / "experiment.toml", seen_from=out)
        for number, (case, answer) in enumerate(answers.items()):
            arrays = {"time_s": answer.times, "displacement_mm": answer.displacement}
            write_npz(folder / f"case_{_file_word(case, number)}.npz", arrays)


def simulated_tables(
    experiment: Experiment, answers: "Mapping[str, CaseSimulation]"
) -> list[tuple[CsvTable, _Histories]]:
    """Return the comma-separated tables of an experiment folder with simulated values, without empty tables.

    `experiment`: the experiment that was simulated; `answers`: the simulation of each case, by the case's name. Result:
    pairs of a table's declaration and its content: by case, the times (n_frames,) in s and, by marker, actuator or
    target, the values (n_frames, 3) in mm or mN.
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
