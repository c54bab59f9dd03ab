"""A data set: thousands of solves on one mesh, in chunks that survive an interruption.

`docs/files.md` describes the folder. A chunk depends on the recipe and its own number alone, so a resumed run makes the
same data as an uninterrupted one.
"""

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._clock import Clock
from tissuereg._version import __version__
from tissuereg.errors import EnsembleError, ExperimentError, FormatError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.drafts import remove_stale_drafts
from tissuereg.material import Material
from tissuereg.mesh import Mesh
from tissuereg.simulate.recipe import Recipe
from tissuereg.simulate.sampling import Event, EventSampler, EventSettings, linear_answers
from tissuereg.simulate.solve import Simulator
from tissuereg.simulate.variation import random_inclusion

SCHEMA = "tissuereg.dataset/1"

#: Most iterations of a member: one that needs more is far beyond what tissue does; it fails instead of delaying others.
_SOLVE = {"tolerance": 1e-6, "max_iterations": 150}

Progress = Callable[[int, int], None]


def make_dataset(
    recipe: Recipe,
    out: str | os.PathLike[str],
    *,
    seed: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Make a data set, or resume an unfinished one.

    Parameters
    ----------
    recipe : Recipe
        Recipe of the data set.
    out : path-like
        Folder; chunks already there are kept.
    seed : int, optional
        Instead of the recipe's.
    threads : int
        Threads to use; 0 takes all cores. The data do not depend on it.
    progress : callable of (int, int), optional
        Called with simulations done and simulations in all.

    Returns
    -------
    dict
        ``members``, ``failed`` (list of [index, reason]), ``members_per_s``, ``seconds``, ``seed``.

    Raises
    ------
    ExperimentError
        If the folder holds another recipe's data.
    FormatError
        If a chunk that is there already is spoilt.
    EnsembleError
        If more than half of a chunk fails.
    """
    folder, clock = Path(out), Clock()
    seed = recipe.seed if seed is None else seed
    with clock.stage("total"):
        with clock.stage("analyse"):
            mesh = recipe.mesh()
            simulator = Simulator(mesh, element=recipe.data.element)
        _begin(folder, recipe, mesh, seed)
        n_chunks = -(-recipe.data.members // recipe.data.chunk)
        in_all = recipe.data.members + recipe.pairs.members
        fresh = 0
        with clock.stage("solve"):
            for chunk in range(n_chunks):
                first = chunk * recipe.data.chunk
                if not (folder / _chunk_name(chunk)).exists():
                    _make_chunk(folder, recipe, simulator, seed, chunk, threads, _from(progress, first, in_all))
                    fresh += min(recipe.data.chunk, recipe.data.members - first)
        with clock.stage("pairs"):
            if recipe.pairs.members and not (folder / "pairs.npz").exists():
                _make_pairs(folder, recipe, simulator, seed, threads)
        if progress is not None:
            progress(in_all, in_all)
        failed = _finish(folder, recipe, mesh, seed, n_chunks)
    return {
        "members": recipe.data.members - len(failed),
        "failed": failed,
        "members_per_s": fresh / clock.seconds["solve"] if fresh else None,
        "seconds": clock.seconds,
        "seed": seed,
    }


def _chunk_name(chunk: int) -> str:
    return f"chunk_{chunk:04d}.npz"


def _from(progress: Progress | None, first: int, in_all: int) -> Callable[[int], None] | None:
    return None if progress is None else (lambda done: progress(first + done, in_all))


def _begin(folder: Path, recipe: Recipe, mesh: Mesh, seed: int) -> None:
    """Mark the folder as this recipe's, or refuse it."""
    identity = {k: v for k, v in recipe.raw.items() if k != "train"}
    mark = hashlib.sha256(json.dumps([identity, seed, mesh.digest(), __version__], sort_keys=True).encode()).hexdigest()
    marker = folder / "recipe.sha256"
    remove_stale_drafts(folder)
    if not marker.exists():
        if folder.exists() and any(folder.iterdir()):
            message = f"{folder} must be empty or hold a data set; it holds other files"
            raise ExperimentError(message, where=str(folder))
        # First of all: a run that is killed after it is gone on with.
        with atomic_file(marker) as path:
            path.write_text(mark + "\n", encoding="utf-8")
    elif marker.read_text(encoding="utf-8").strip() != mark:
        message = f"{folder} must be empty or hold data of this very recipe, seed, mesh and version; it holds another's"
        raise ExperimentError(message, where=str(folder))
    if not (folder / "mesh.npz").exists():
        _save(folder / "mesh.npz", nodes_mm=mesh.nodes, tets=mesh.tets, fixed_nodes=mesh.fixed_nodes)


def _events(
    recipe: Recipe, simulator: Simulator, material: Material, n: int, rng: np.random.Generator, threads: int
) -> tuple[list[Event], FloatArray]:
    """Return random events and their sizes in mN under `material`."""
    data = recipe.data
    extent = simulator.mesh.extent
    radius = (data.radius_mm[0] / extent, data.radius_mm[1] / extent)
    sampler = EventSampler(simulator.mesh, EventSettings(data.n_patches, radius, data.body_force_share))
    events = [sampler.draw(rng) for _ in range(n)]
    _, unit = linear_answers(simulator, events, material, threads=threads)
    return events, unit * rng.uniform(*data.largest_mm, n)


def _make_chunk(
    folder: Path,
    recipe: Recipe,
    simulator: Simulator,
    seed: int,
    chunk: int,
    threads: int,
    progress: Callable[[int], None] | None,
) -> None:
    rng = np.random.default_rng([seed, 3, chunk])
    first = chunk * recipe.data.chunk
    n = min(recipe.data.chunk, recipe.data.members - first)
    young = rng.uniform(*recipe.material.young_kpa, n)
    softest = Material(recipe.material.young_kpa[0], recipe.material.poisson)
    events, size = _events(recipe, simulator, softest, n, rng, threads)
    size = size * young / recipe.material.young_kpa[0]  # the wanted motion holds at the member's own modulus
    loads = [event.load(simulator, s) for event, s in zip(events, size, strict=True)]
    materials = [Material(y, recipe.material.poisson) for y in young]
    found = simulator.solve_many(loads, materials, threads=threads, progress=progress, **_SOLVE)
    solved = found.solved
    if len(solved) < n / 2:
        message = f"at least half of a chunk must find equilibrium, {len(solved)} of {n} did; lower [data] largest_mm"
        raise EnsembleError(message, dropped=found.failed)
    _save(
        folder / _chunk_name(chunk),
        index=first + solved,
        displacement_mm=found.displacement[solved].astype(np.float32),
        young_kpa=young[solved],
        failed_index=np.array([first + i for i, _ in found.failed], dtype=np.int64),
        failed_reason=np.array([reason for _, reason in found.failed], dtype=np.str_),
    )


def _make_pairs(folder: Path, recipe: Recipe, simulator: Simulator, seed: int, threads: int) -> None:
    rng = np.random.default_rng([seed, 4])
    pairs, mesh = recipe.pairs, simulator.mesh
    believed = Material(recipe.material.young_kpa[0], recipe.material.poisson)
    events, size = _events(recipe, simulator, believed, pairs.members, rng, threads)
    true_simulator = Simulator(mesh, element=pairs.element)
    loads, true_loads, truths = [], [], []
    for event, s in zip(events, size, strict=True):
        loads.append(event.load(simulator, s))
        load, material = pairs.variation.draw(event.load(true_simulator, s), believed, rng)
        true_loads.append(load)
        truths.append(Material(material.young_array * _inclusion(mesh, recipe, rng), believed.poisson))
    simulated = simulator.solve_many(loads, [believed] * len(loads), threads=threads, **_SOLVE)
    true = true_simulator.solve_many(true_loads, truths, threads=threads, **_SOLVE)
    both = np.intersect1d(simulated.solved, true.solved)
    if len(both) < pairs.members / 2:
        message = f"at least half of the pairs must find equilibrium, {len(both)} of {pairs.members} did"
        raise EnsembleError(message, dropped=simulated.failed + true.failed)
    _save(
        folder / "pairs.npz",
        simulation_mm=simulated.displacement[both].astype(np.float32),
        truth_mm=true.displacement[both].astype(np.float32),
    )


def _inclusion(mesh: Mesh, recipe: Recipe, rng: np.random.Generator) -> FloatArray:
    """Return the factor on Young's modulus of every tet: a stiff ball around a random node, or none."""
    pairs = recipe.pairs
    ball = random_inclusion(mesh, rng, pairs.inclusion_radius_mm, pairs.inclusion_contrast)
    return ball if rng.random() < pairs.inclusion_share else np.ones(mesh.n_tets)


def _finish(folder: Path, recipe: Recipe, mesh: Mesh, seed: int, n_chunks: int) -> list[list[Any]]:
    failed: list[list[Any]] = []
    for chunk in range(n_chunks):
        failed += _failed_of(folder / _chunk_name(chunk))
    card = {
        "schema": SCHEMA,
        "recipe": recipe.raw,
        "mesh_digest": mesh.digest(),
        "n_nodes": mesh.n_nodes,
        "seed": seed,
        "members": recipe.data.members - len(failed),
        "failed": failed,
        "chunks": [_chunk_name(chunk) for chunk in range(n_chunks)],
        "pairs": "pairs.npz" if recipe.pairs.members else None,
        "version": __version__,
    }
    with atomic_file(folder / "dataset.json") as path:
        path.write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    return failed


def _failed_of(path: Path) -> list[list[Any]]:
    try:
        with np.load(path, allow_pickle=False) as kept:
            return [[int(i), str(r)] for i, r in zip(kept["failed_index"], kept["failed_reason"], strict=True)]
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        message = (
            f"{path} must be a whole chunk of the data set: {error}. Delete it, and the same command makes it anew"
        )
        raise FormatError(message, where=str(path)) from error


def _save(path: Path, **arrays: Any) -> None:
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)
