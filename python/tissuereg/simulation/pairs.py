"""Pairs of simulations in a data set: one event by the believed model (as assumed) and by another model."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.body.material import Material
from tissuereg.errors import EnsembleError
from tissuereg.io.fields import PAIRS_SCHEMA, check_pairs
from tissuereg.io.hdf5 import array_of, opened, packed
from tissuereg.io.stores import store_of
from tissuereg.simulation.chunks import SOLVE, SOLVE_ITERATIONS, ChunkMaker, ChunkTask, chunk_maker
from tissuereg.simulation.recipe import random_inclusion
from tissuereg.simulation.solve import Simulator

PAIRS_NAME = "pairs.h5"


@dataclass(frozen=True)
class PairsReport:
    """Summary of the file that holds the pairs of simulations of a data set.

    `n_bytes`: its size in bytes; `sha256`: its SHA-256, hexadecimal; `made`: whether it was made now (False if it was
    there already).
    """

    n_bytes: int
    sha256: str
    made: bool


def make_pairs(task: ChunkTask, progress: Callable[[int], None] | None = None) -> PairsReport:
    """Simulate pairs of displacement fields, and write them unless a valid file is there; return a summary of the file.

    A pair is the answer of the assumed (believed) model to a random load, and that of another model, the truth, to a
    varied load. `task`: any chunk task of the data set, for its recipe, seed and folder; `progress`: called with the
    number of simulations done, two a pair. Raises `EnsembleError` if more than half of the pairs fail; `FormatError` if
    the pairs are there already, but spoilt; `OutputError` if they cannot be written.
    """
    store = store_of(task.destination)
    made = not store.exists(PAIRS_NAME)
    if not made:
        content = store.read(PAIRS_NAME)
        _check(task, content)
    else:
        simulations, truths = simulated_pairs(chunk_maker(task), task.threads, progress=progress)
        arrays = {
            "simulation_mm": simulations.astype(np.float32),
            "truth_mm": truths.astype(np.float32),
        }
        attributes = {"schema": PAIRS_SCHEMA, "recipe_sha256": task.mark, "version": __version__}
        content = packed(arrays, attributes, frozenset(arrays))
        store.write(PAIRS_NAME, content)
    return PairsReport(len(content), hashlib.sha256(content).hexdigest(), made)


def _check(task: ChunkTask, content: bytes) -> None:
    """Refuse a file of pairs (`content`, its bytes) that is spoilt or of another data set, by `FormatError`."""
    store = store_of(task.destination)
    where, n_nodes = store.where(PAIRS_NAME), chunk_maker(task).simulator.mesh.n_nodes
    with opened(store, PAIRS_NAME, content) as file:
        check_pairs(file, where, task.mark)
        n_pairs = len(array_of(file, where, "simulation_mm", "f", (None, n_nodes, 3)))
        array_of(file, where, "truth_mm", "f", (n_pairs, n_nodes, 3))


def simulated_pairs(
    maker: ChunkMaker,
    threads: int = 0,
    *,
    max_iterations: int = SOLVE_ITERATIONS,
    progress: Callable[[int], None] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return pairs of displacement fields under a random load: of the assumed model, and of another one, the truth.

    `maker`: recipe, mesh and seed; `threads`: threads to use; 0 takes all cores. The pairs do not depend on it;
    `max_iterations`: a simulation that needs more fails, and its pair with it; `progress`: as of `make_pairs`. Result:
    `simulations`, `truths` (n_pairs, n_nodes, 3): displacements of the assumed (believed) model and of the other one,
    mm; a pair is left out if either simulation found no equilibrium. Raises `EnsembleError` if more than half of the
    pairs fail.
    """
    recipe, simulator = maker.recipe, maker.simulator
    # A stream of its own: what else is drawn does not depend on Poisson's ratio.
    rng, of_poisson = np.random.default_rng([maker.seed, 4]), np.random.default_rng([maker.seed, 5])
    pairs = recipe.pairs
    believed = Material(recipe.material.young_kpa[0], recipe.material.poisson)
    events, size, _ = maker.events(believed, pairs.members, rng, threads)
    true_simulator = Simulator(simulator.mesh, element=pairs.element)
    loads, true_loads, truths = [], [], []
    for event, s in zip(events, size, strict=True):
        loads.append(event.load(simulator, s))
        load, material = pairs.variation.draw(event.load(true_simulator, s), believed, rng)
        true_loads.append(load)
        poisson = believed.poisson + of_poisson.uniform(*pairs.poisson_change)
        truths.append(Material(material.young_array * _inclusion(maker, rng), poisson))
    how: dict[str, Any] = {**SOLVE, "threads": threads, "max_iterations": max_iterations}
    simulated = simulator.solve_many(loads, [believed] * len(loads), progress=progress, **how)
    then = None if progress is None else (lambda n: progress(len(loads) + n))
    true = true_simulator.solve_many(true_loads, truths, progress=then, **how)
    both = np.intersect1d(simulated.solved, true.solved)
    if len(both) < pairs.members / 2:
        message = f"at least half of the pairs must find equilibrium, {len(both)} of {pairs.members} did"
        raise EnsembleError(message, dropped=simulated.failed + true.failed)
    return simulated.displacement[both], true.displacement[both]


def _inclusion(maker: ChunkMaker, rng: np.random.Generator) -> FloatArray:
    """Return a factor on Young's modulus (n_tets,): another one in a ball about a random node, or one everywhere.

    The recipe states the probability of a ball, and the ranges of its radius and factor.
    """
    pairs, mesh = maker.recipe.pairs, maker.simulator.mesh
    ball = random_inclusion(mesh, rng, pairs.inclusion_radius_mm, pairs.inclusion_contrast)
    return ball if rng.random() < pairs.inclusion_share else np.ones(mesh.n_tets)
