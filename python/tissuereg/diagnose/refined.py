"""What a model says on finer meshes: one that corrects the user's, and others that tell how good it is."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bank import fingerprint
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.predictor import refuse_failures
from tissuereg.diagnose.signals import Layout
from tissuereg.effects import Effect, extended
from tissuereg.experiment import Experiment
from tissuereg.io.cache import cache_folder, keep_in_cache
from tissuereg.simulate.experiment import CaseSimulation
from tissuereg.simulate.fine import FineModel, third_meshes
from tissuereg.simulate.memory import remembers

#: Raised when fine meshes give other answers: those of other releases are not read.
SCHEMA = 2

#: Finer meshes beside the one that corrects.
THIRDS = 3

#: Rigs whose answers are kept: they take long to make and some 0.1 MB each.
MOST_FILES = 500


def flat_of(layout: Layout, answers: dict[str, CaseSimulation]) -> FloatArray:
    """Return simulated cases as a flat vector.

    Parameters
    ----------
    layout : Layout
        Its order.
    answers : dict of str to CaseSimulation
        All cases.

    Returns
    -------
    ndarray of float64, shape (size,)
        mm and mN.

    Raises
    ------
    ConvergenceError
        If a frame found no equilibrium.
    """
    for name, answer in answers.items():
        refuse_failures(name, answer.failed)
    return layout.flatten(
        {name: answer.markers for name, answer in answers.items()},
        {name: answer.forces for name, answer in answers.items()},
    )


def path_of(experiment: Experiment) -> Path:
    """Return the file in the cache that keeps what a believed model says on finer meshes."""
    return cache_folder() / f"fine_{fingerprint(experiment, f'tet10 {SCHEMA}')}.npy"


def refined_predictions(
    bench: Bench, path: Path | None, *, thirds: int = THIRDS, progress: Callable[[str], None] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return what the believed model says on the fine mesh, and on others of another error.

    Parameters
    ----------
    bench : Bench
        The believed model.
    path : Path, optional
        File that keeps them between calls; see `path_of`.
    thirds : int
        Number of other meshes.
    progress : callable of str, optional
        Called with what is at work.

    Returns
    -------
    tuple of ndarray of float64, shapes (size,) and (thirds, size)
        mm and mN.

    Raises
    ------
    ConvergenceError
        If a frame finds no equilibrium.
    """
    kept = None if path is None else _read(path)
    if kept is not None and kept.shape == (1 + thirds, bench.layout.size):
        return kept[0], kept[1:]
    found = []
    for number, model in enumerate(_models(bench, thirds)):
        if progress is not None:
            progress("fine mesh" if number == 0 else f"other mesh {number}")
        found.append(flat_of(bench.layout, model.simulate(threads=bench.predictor.threads)))
    made = np.array(found)
    if path is not None:
        keep_in_cache(path, lambda stream: np.save(stream, made), MOST_FILES)
    return made[0], made[1:]


def refined_effects(bench: Bench, effects: Sequence[Effect]) -> FloatArray | None:
    """Return what the believed model with further effects says on the fine mesh.

    Parameters
    ----------
    bench : Bench
        The believed model.
    effects : sequence of Effect
        Beside those of the experiment.

    Returns
    -------
    ndarray of float64, shape (size,), or None
        mm and mN. None where the material remembers: such frames take minutes on a fine mesh, and what a body remembers
        of a load has the error of the load's own answer, which the believed model's correction carries.

    Raises
    ------
    ConvergenceError
        If a frame finds no equilibrium.
    """
    every = (*bench.experiment.effects, *effects)
    if remembers(extended(replace(bench.experiment, effects=every), bench.predictor.element)):
        return None
    return flat_of(bench.layout, bench.fine.simulate(every, warm=True, threads=bench.predictor.threads))


def _models(bench: Bench, thirds: int) -> Iterator[FineModel]:
    yield bench.fine
    yield from third_meshes(bench.experiment, thirds, seed=0)


def _read(path: Path) -> FloatArray | None:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError):
        return None
