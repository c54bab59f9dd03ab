"""Predictions of the believed model on fine meshes: one that corrects, and others that measure what error it leaves.

Meshing and solving take long; predictions of the believed model are cached, named by a hash of all that they depend on.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bank import fingerprint
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.predictor import refuse_failures
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Effect, extended
from tissuereg.experiment.experiment import Experiment
from tissuereg.io.cache import keep_entry, read_entry
from tissuereg.simulation.experiment import CaseSimulation
from tissuereg.simulation.fine import FineModel, third_meshes
from tissuereg.simulation.memory import remembers

#: To be increased when fine meshes give other results, so that older files are not read.
SCHEMA = 2

#: Number of cached entries, some 0.1 MB each; the oldest are deleted.
MOST_ENTRIES = 500


def flat_of(layout: SignalLayout, answers: dict[str, CaseSimulation]) -> FloatArray:
    """Return simulated cases as a flat vector (size,): marker displacements in mm and forces in mN.

    `layout`: order of the vector; `answers`: simulation of every case, by name. Raises `ConvergenceError` if a frame
    has no equilibrium.
    """
    for name, answer in answers.items():
        refuse_failures(name, answer.failed)
    return layout.flatten(
        {name: answer.markers for name, answer in answers.items()},
        {name: answer.forces for name, answer in answers.items()},
    )


def entry_of(experiment: Experiment) -> str:
    """Return the name of the cache entry that holds a believed model's predictions on fine meshes."""
    return f"fine_{fingerprint(experiment, f'tet10 {SCHEMA}')}"


def refined_predictions(bench: Bench, entry: str | None) -> tuple[FloatArray, FloatArray]:
    """Return the prediction of the believed model on the correcting fine mesh, and those on further fine meshes.

    `bench`: the believed model; `entry`: name of the cached entry (`entry_of`), None to use no cache. Result: (size,)
    and (thirds, size), mm and mN. Raises `ConvergenceError` if a frame has no equilibrium.
    """
    thirds = bench.settings.model.thirds
    kept = None if entry is None else _read(entry)
    if kept is not None and kept.shape == (1 + thirds, bench.layout.size):
        return kept[0], kept[1:]
    found = []
    for number, model in enumerate(_models(bench, thirds)):
        bench.progress("fine mesh" if number == 0 else f"other mesh {number}")
        found.append(flat_of(bench.layout, model.simulate(threads=bench.predictor.threads)))
    made = np.array(found)
    if entry is not None:
        content = io.BytesIO()
        np.save(content, made)
        keep_entry(entry, content.getvalue(), MOST_ENTRIES)
    return made[0], made[1:]


def refined_effects(bench: Bench, effects: Sequence[Effect]) -> FloatArray | None:
    """Return the prediction (size,) of the believed model with further effects on the fine mesh, mm and mN.

    `bench`: the believed model; `effects`: in addition to those of the experiment. The result is None where the
    material has memory: such histories take minutes on a fine mesh, and the discretisation error of a memory effect is
    that of the load's own response, which the correction of the believed model contains. Raises `ConvergenceError` if a
    frame has no equilibrium.
    """
    every = (*bench.experiment.effects, *effects)
    if remembers(extended(replace(bench.experiment, effects=every), bench.predictor.element)):
        return None
    return flat_of(bench.layout, bench.fine.simulate(every, warm=True, threads=bench.predictor.threads))


def _models(bench: Bench, thirds: int) -> Iterator[FineModel]:
    yield bench.fine
    yield from third_meshes(bench.experiment, thirds, seed=0)


def _read(entry: str) -> FloatArray | None:
    content = read_entry(entry)
    return None if content is None else np.asarray(np.load(io.BytesIO(content), allow_pickle=False))
