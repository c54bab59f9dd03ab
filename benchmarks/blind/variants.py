"""The diagnoser as it is, with another catalogue, and with one step removed, for `blind.run`.

Names and constants in modules of `tissuereg.diagnosis` are patched in the running process and restored after every
case; the package itself has no such settings, and needs none. A name that no longer exists is an error, so that no
step is silently left in.

Stored banks stay valid. Their files depend on the experiment and may hold any part of the catalogue; a larger catalogue
adds its missing parts, and causes in closed form are never stored. Forces are ignored by marking them as not measured,
which changes no bank.
"""

import copy
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from blind.heldout import by_block
from tissuereg.diagnosis import candidates, diagnose, findings, recorrect, run, search
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.nuisances import Nuisances
from tissuereg.diagnosis.nulls import Nulls
from tissuereg.diagnosis.proof import GENERIC, NAMED, HeldOut, linear_model
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment
from tissuereg.io.experiments import read_experiment
from tissuereg.io.json import plain

#: Threshold of the oracle fit: anything passes.
NO_THRESHOLD = -1e6

#: Level of the misfit test for the oracle fit: no p-value is below it, so the fit is never rejected.
ANY_MISFIT = 0.0

#: Nuisances of the mesh's error and of the shape begin with these words.
OF_THE_MESH = (
    "mesh ",
    "bent ",
    "place of ",
    "rim of ",
    "size of ",
    "height of ",
    "tilt of ",
    "edge of ",
    "facets",
    "surface ",
)


def ours(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the diagnoser's answer, as its command would."""
    return answer(read_experiment(folder), threads)


def answer(experiment: Experiment, threads: int) -> dict:
    """Return a diagnosis as in its JSON, with the errors of the models before and after it on held-out blocks."""
    found = diagnose(experiment, threads=threads)
    target, searched = found.details["target"], found.details["search"]
    base, final = (linear_model(target, fit) for fit in (searched.base, searched.final))
    return plain({**found.to_json(), "by_block": by_block(base, final, target.bench.layout)})


def oracle(folder: Path, ids: Collection[str], *, threads: int = 0) -> dict:
    """Return the fit of the given causes: the catalogue holds nothing else, and all of it is accepted."""
    ids = list(ids)
    with (
        catalogue(ids),
        no_judge(),
        patch.object(run, "draw_nulls", _then(run.draw_nulls, _without_threshold)),
        patch.object(run, "MISFIT", ANY_MISFIT),
        patch.object(search, "MOST_CAUSES", len(ids)),
        patch.object(candidates, "_repeats", lambda name: ids.count(name) > 1),
    ):
        return ours(folder, threads=threads)


def without(folder: Path, ids: Collection[str], *, threads: int = 0) -> dict:
    """Return the diagnoser's answer without the given causes in its catalogue."""
    with catalogue(set(CAUSES) - set(ids)):
        return ours(folder, threads=threads)


def no_mesh_correction(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer without a correction of predictions on the user's mesh."""
    with (
        patch.object(run, "make_correction", _no_correction),
        patch.object(recorrect, "recorrected", lambda target, found, **_: target),
    ):
        return ours(folder, threads=threads)


def no_third_mesh(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer with threshold and misfit calibrated by draws of the noise alone."""
    with patch.object(run, "draw_nulls", _of_noise_alone(run.draw_nulls)):
        return ours(folder, threads=threads)


def no_forces(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer without measured forces."""
    return answer(forceless(read_experiment(folder)), threads)


def no_proof(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer when a cause that passes the threshold needs no proof on held-out data."""
    with no_judge():
        return ours(folder, threads=threads)


def no_mesh_nuisances(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer when the correction of the mesh's error is taken to be exact."""
    with patch.object(run, "make_nuisances", _then(run.make_nuisances, _but_the_mesh)):
        return ours(folder, threads=threads)


@contextmanager
def catalogue(ids: Collection[str]) -> Iterator[None]:
    """Restrict the catalogue to some causes, in its order; without stiffness, its own finding is removed too."""
    with patch.dict(CAUSES, {name: cause for name, cause in CAUSES.items() if name in ids}, clear=True):
        if "stiffness" in CAUSES:
            yield
            return
        with patch.object(findings, "modulus_finding", lambda *_: None):
            yield


@contextmanager
def no_judge() -> Iterator[None]:
    """Evaluate held-out data, and let every cause pass whatever the result."""
    with patch.object(search, "_prove", _then(search._prove, _passed)):
        yield


def forceless(experiment: Experiment) -> Experiment:
    """Return an experiment whose forces are marked as not measured."""
    cases = {
        name: replace(case, forces={pad: np.full_like(values, np.nan) for pad, values in case.forces.items()})
        for name, case in experiment.cases.items()
    }
    return replace(experiment, cases=cases)


def _then(made: Callable, change: Callable) -> Callable:
    """Return a function whose result is passed through another."""
    return lambda *given, **named: change(made(*given, **named))


def _without_threshold(nulls: Nulls) -> Nulls:
    return replace(nulls, thresholds=dict.fromkeys(nulls.thresholds, NO_THRESHOLD))


def _passed(proof: HeldOut) -> HeldOut:
    """Return a proof in which the earlier model and the generic rival predict worse than the cause in every block."""
    worse = np.full((len(proof.log_density), 1), search.PROVED + 1.0)
    worse[[NAMED, GENERIC], 0] = 0.0, 1e-6
    return replace(proof, log_density=np.minimum(proof.log_density, proof.log_density[NAMED] - worse))


def _no_correction(layout: SignalLayout, coarse: np.ndarray, fine: np.ndarray) -> Correction:
    return Correction(layout)


def _of_noise_alone(draw_nulls: Callable) -> Callable:
    def drawn(screen, null, noise, layout, mesh_errors, seed):
        # Nuisances are fitted to the draws as usual, but the draws contain none.
        bare = copy.copy(null)
        bare.nuisances = null.nuisances[:0]
        return draw_nulls(screen, bare, noise, layout, [], seed)

    return drawn


def _but_the_mesh(nuisances: Nuisances) -> Nuisances:
    kept = [i for i, name in enumerate(nuisances.names) if not name.startswith(OF_THE_MESH)]
    return Nuisances(tuple(nuisances.names[i] for i in kept), nuisances.columns[kept])
