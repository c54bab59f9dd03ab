"""The diagnoser as it is, with another catalogue, and with one step removed, for `blind.run`: changed settings.

Stored banks stay valid. Their files depend on the experiment and may hold any part of the catalogue; a larger catalogue
adds its missing parts, and causes in closed form are never stored. Forces are ignored by marking them as not measured,
which changes no bank.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from blind.heldout import by_block
from tissuereg.diagnosis import diagnose
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.proof import linear_model
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.experiment.experiment import Experiment
from tissuereg.io.experiments import read_experiment
from tissuereg.io.json import plain

#: Threshold of the oracle fit: anything passes.
NO_THRESHOLD = -1e6

#: Level of the tests of misfit and constancy for the oracle fit: no p-value is below it, so the fit is never rejected.
ANY_MISFIT = 0.0


def ours(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the diagnoser's answer, as its command would."""
    return answer(read_experiment(folder), threads)


def answer(experiment: Experiment, threads: int, settings: DiagnoseSettings = DEFAULT) -> dict:
    """Return a diagnosis as in its JSON, with the errors of the models before and after it on held-out blocks."""
    found = diagnose(experiment, threads=threads, settings=settings)
    target, searched = found.details.target, found.details.search
    base, final = (linear_model(target, fit) for fit in (searched.base, searched.final))
    return plain({**found.to_json(), "by_block": by_block(base, final, target.bench.layout)})


def oracle_settings(ids: Collection[str]) -> DiagnoseSettings:
    """Return the settings of the fit of given causes: nothing else is tried, and all of it is accepted."""
    ids = list(ids)
    return replace(
        DEFAULT,
        left_out=tuple(name for name in CAUSES if name not in ids),
        nulls=replace(DEFAULT.nulls, required=NO_THRESHOLD, misfit=ANY_MISFIT),
        constancy=replace(DEFAULT.constancy, level=ANY_MISFIT),
        search=replace(
            DEFAULT.search,
            most_causes=len(ids),
            repeated=tuple(name for name in ids if ids.count(name) > 1),
            judged=False,
            stated=0.0,
        ),
    )


def without_settings(ids: Collection[str]) -> DiagnoseSettings:
    """Return the settings whose catalogue lacks some causes."""
    return replace(DEFAULT, left_out=tuple(ids))


def oracle(folder: Path, ids: Collection[str], *, threads: int = 0) -> dict:
    """Return the fit of the given causes: the catalogue holds nothing else, and all of it is accepted."""
    return answer(read_experiment(folder), threads, oracle_settings(ids))


def without(folder: Path, ids: Collection[str], *, threads: int = 0) -> dict:
    """Return the diagnoser's answer without the given causes in its catalogue."""
    return answer(read_experiment(folder), threads, without_settings(ids))


def no_mesh_correction(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer without a correction of predictions on the user's mesh."""
    settings = replace(DEFAULT, model=replace(DEFAULT.model, corrected=False))
    return answer(read_experiment(folder), threads, settings)


def no_third_mesh(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer with threshold and misfit calibrated by draws of the noise alone."""
    settings = replace(DEFAULT, nulls=replace(DEFAULT.nulls, noise_alone=True))
    return answer(read_experiment(folder), threads, settings)


def no_forces(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer without measured forces."""
    return answer(forceless(read_experiment(folder)), threads)


def no_proof(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer when a cause that passes the threshold needs no proof on held-out data."""
    settings = replace(DEFAULT, search=replace(DEFAULT.search, judged=False))
    return answer(read_experiment(folder), threads, settings)


def no_mesh_nuisances(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer when the correction of the mesh's error is taken to be exact."""
    settings = replace(DEFAULT, nuisances=replace(DEFAULT.nuisances, of_mesh=False))
    return answer(read_experiment(folder), threads, settings)


def forceless(experiment: Experiment) -> Experiment:
    """Return an experiment whose forces are marked as not measured."""
    cases = {
        name: replace(case, forces={pad: np.full_like(values, np.nan) for pad, values in case.forces.items()})
        for name, case in experiment.cases.items()
    }
    return replace(experiment, cases=cases)
