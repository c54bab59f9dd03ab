"""The diagnoser as it is, with another catalogue, and with one step taken out, for `blind.run`.

Names and constants in modules of `tissuereg.diagnose` are replaced in the running process, and put back after every
case. That is this bench's own business: the package has no such settings, and needs none. A name that is no longer
there is an error, so that no step is silently left in.

Stored banks stay right. Their files hang on the experiment, hold any part of the catalogue, and get what a later
catalogue asks for beside what is there; causes in closed form are never stored. Forces are ignored by taking them for
not measured, which changes no bank.
"""

import copy
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from blind.heldout import by_block
from tissuereg.diagnose import candidates, diagnose, findings, recorrect, run, search
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.correction import Correction
from tissuereg.diagnose.nuisances import Nuisances
from tissuereg.diagnose.nulls import Nulls
from tissuereg.diagnose.proof import GENERIC, NAMED, HeldOut, linear_model
from tissuereg.diagnose.signals import Layout
from tissuereg.experiment import Experiment
from tissuereg.io.experiments import read_experiment
from tissuereg.io.json import plain

#: What a told fit has for a threshold: anything passes.
NO_THRESHOLD = -1e6

#: A probability that no misfit is below: whatever it leaves, a told fit is not taken back.
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


def ours(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what the diagnoser says, as its command would."""
    return answer(read_experiment(folder), threads)


def answer(experiment: Experiment, threads: int) -> dict:
    """Return a diagnosis as it stands in JSON, and what the models before and after it predict of held-out blocks."""
    found = diagnose(experiment, threads=threads)
    target, searched = found.details["target"], found.details["search"]
    base, final = (linear_model(target, fit) for fit in (searched.base, searched.final))
    return plain({**found.to_json(), "by_block": by_block(base, final, target.bench.layout)})


def oracle(folder: Path, told: Collection[str], *, threads: int = 0) -> dict:
    """Return the fit of the causes that are told: the catalogue holds nothing else, and all of it is accepted."""
    told = list(told)
    with (
        catalogue(told),
        no_judge(),
        patch.object(run, "draw_nulls", _then(run.draw_nulls, _without_threshold)),
        patch.object(run, "MISFIT", ANY_MISFIT),
        patch.object(search, "MOST_CAUSES", len(told)),
        patch.object(candidates, "_repeats", lambda name: told.count(name) > 1),
    ):
        return ours(folder, threads=threads)


def without(folder: Path, told: Collection[str], *, threads: int = 0) -> dict:
    """Return what the diagnoser says when the told causes are not in its catalogue."""
    with catalogue(set(CAUSES) - set(told)):
        return ours(folder, threads=threads)


def no_mesh_correction(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what is said when predictions on the user's mesh are taken as they are."""
    with (
        patch.object(run, "make_correction", _no_correction),
        patch.object(recorrect, "recorrected", lambda target, found, **_: target),
    ):
        return ours(folder, threads=threads)


def no_third_mesh(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what is said when threshold and misfit are judged by draws of the noise alone."""
    with patch.object(run, "draw_nulls", _of_noise_alone(run.draw_nulls)):
        return ours(folder, threads=threads)


def no_forces(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what is said when no force was measured."""
    return answer(forceless(read_experiment(folder)), threads)


def no_proof(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what is said when a cause that passes the threshold needs no proof on what was held out."""
    with no_judge():
        return ours(folder, threads=threads)


def no_mesh_nuisances(folder: Path, told: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return what is said when the correction of the mesh's error is taken to be exact."""
    with patch.object(run, "make_nuisances", _then(run.make_nuisances, _but_the_mesh)):
        return ours(folder, threads=threads)


@contextmanager
def catalogue(ids: Collection[str]) -> Iterator[None]:
    """Have some causes alone in the catalogue, in its order; without stiffness, its own finding goes too."""
    with patch.dict(CAUSES, {name: cause for name, cause in CAUSES.items() if name in ids}, clear=True):
        if "stiffness" in CAUSES:
            yield
            return
        with patch.object(findings, "modulus_finding", lambda *_: None):
            yield


@contextmanager
def no_judge() -> Iterator[None]:
    """Have held-out data measured, and every cause pass, whatever they say."""
    with patch.object(search, "_prove", _then(search._prove, _passed)):
        yield


def forceless(experiment: Experiment) -> Experiment:
    """Return an experiment whose measured forces are not measured."""
    cases = {
        name: replace(case, forces={pad: np.full_like(values, np.nan) for pad, values in case.forces.items()})
        for name, case in experiment.cases.items()
    }
    return replace(experiment, cases=cases)


def _then(made: Callable, change: Callable) -> Callable:
    """Return a function whose result is changed."""
    return lambda *given, **named: change(made(*given, **named))


def _without_threshold(nulls: Nulls) -> Nulls:
    return replace(nulls, thresholds=dict.fromkeys(nulls.thresholds, NO_THRESHOLD))


def _passed(proof: HeldOut) -> HeldOut:
    """Return a proof in which the model before, and the generic rival, predict worse than the cause in every block."""
    worse = np.full((len(proof.log_density), 1), search.PROVED + 1.0)
    worse[[NAMED, GENERIC], 0] = 0.0, 1e-6
    return replace(proof, log_density=np.minimum(proof.log_density, proof.log_density[NAMED] - worse))


def _no_correction(layout: Layout, coarse: np.ndarray, fine: np.ndarray) -> Correction:
    return Correction(layout)


def _of_noise_alone(draw_nulls: Callable) -> Callable:
    def drawn(screen, null, noise, layout, mesh_errors, seed):
        # Nuisances are taken out of the draws as ever, and none are put in.
        bare = copy.copy(null)
        bare.nuisances = null.nuisances[:0]
        return draw_nulls(screen, bare, noise, layout, [], seed)

    return drawn


def _but_the_mesh(nuisances: Nuisances) -> Nuisances:
    kept = [i for i, name in enumerate(nuisances.names) if not name.startswith(OF_THE_MESH)]
    return Nuisances(tuple(nuisances.names[i] for i in kept), nuisances.columns[kept])
