"""Experiments out: one file that points to the mesh and the tables of another folder."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import of_kind, place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Actuator, Boundary, Experiment
from tissuereg.io.atomic import OutputError
from tissuereg.io.toml_text import toml_text, write_toml


def write_experiment(
    experiment: Experiment, path: str | os.PathLike[str], *, seen_from: str | os.PathLike[str] | None = None
) -> None:
    """Write an experiment file that `read_experiment` reads back, effects included.

    Mesh and tables stay where they are; the file refers to them from its own place.

    Parameters
    ----------
    experiment : Experiment
        Read from files; beliefs and effects may have been changed since, cases and patches not.
    path : path-like
        The file, for example ``experiment.extended.toml``; an older one is replaced as a whole.
    seen_from : path-like, optional
        Folder in which the file will be read, where it is written elsewhere first; need not exist.

    Raises
    ------
    ExperimentError
        If a value cannot stand in such a file: a modulus per tet, fibres in the material, a patch without a rule.
    OutputError
        If the file cannot be written there.
    """
    of_kind("experiment", experiment, Experiment, error=ExperimentError)
    path = place("path", path, error=OutputError)
    write_toml(path, _content(experiment, path.parent if seen_from is None else Path(seen_from)))


def experiment_text(experiment: Experiment, folder: str | os.PathLike[str]) -> str:
    """Return what `write_experiment` writes for a folder.

    Parameters
    ----------
    experiment : Experiment
        As there.
    folder : path-like
        In which the file is to be read; need not exist.

    Returns
    -------
    str
        TOML.

    Raises
    ------
    ExperimentError
        As there.
    """
    return toml_text(_content(experiment, Path(folder)))


def _content(experiment: Experiment, folder: Path) -> dict[str, Any]:
    folder = folder.absolute()
    material = experiment.material
    if material.fibre is not None:
        message = "fibres of an experiment file must be an effect, got them in the material"
        raise ExperimentError(message, where="fibre")
    content: dict[str, Any] = {"name": experiment.name}
    if not _same(folder, experiment.folder):
        content["tables"] = path_from(folder, experiment.folder)
    content["mesh"] = {"file": path_from(folder, experiment.mesh_file)}
    if experiment.surface_std:
        content["mesh"]["surface_std_mm"] = experiment.surface_std
    if experiment.surface_length is not None:
        content["mesh"]["surface_length_mm"] = experiment.surface_length
    content["material"] = {
        "law": material.law,
        **{key: value if np.ndim(value) == 0 else list(value) for key, value in material.shape.items()},
        "volumetric": material.volumetric,
        "young_kpa": _belief("young", material.young_array, experiment.young_std),
        "poisson": _belief("poisson", material.poisson_array, experiment.poisson_std),
        "density_g_per_cm3": material.density,
    }
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
        content["simulated"] = {"model": experiment.simulated.model, "element": experiment.simulated.element}
    content["boundary"] = [_patch(boundary) for boundary in experiment.boundaries]
    content["actuator"] = [{**_patch(actuator), "contact": actuator.contact} for actuator in experiment.actuators]
    content["target"] = [{"name": name, "reference": place.tolist()} for name, place in experiment.targets.items()]
    content["effect"] = [effect.table() for effect in experiment.effects]
    return {key: value for key, value in content.items() if value != []}


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


def _belief(name: str, mean: FloatArray, std: float | None) -> float | list[float]:
    if mean.size != 1:
        message = f"`{name}` of an experiment file must be one for the whole body, got {mean.size} values"
        raise ExperimentError(message, where=name)
    return float(mean[0]) if std is None else [float(mean[0]), std]


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def path_from(folder: Path, place: Path) -> str:
    """Return a path as seen from a folder, links resolved, with forward slashes; the whole path on another drive."""
    try:
        return Path(os.path.relpath(os.path.realpath(place), os.path.realpath(folder))).as_posix()
    except ValueError:
        return place.absolute().as_posix()
