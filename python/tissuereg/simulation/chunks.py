"""One chunk of a data set: simulations under random loads on a mesh that is analysed once, solved together.

A chunk depends on the recipe, the seed and its own number alone, whichever process makes it. `make_one_chunk` is the
task of a worker: it writes its chunk itself and returns a small report, so that nothing heavy passes between processes.
"""

import hashlib
import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._version import __version__
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import EnsembleError, ExperimentError
from tissuereg.io.chunks import CHUNK_SCHEMA, Chunk, Fields, chunk_name, pack_chunk, read_chunk
from tissuereg.io.datasets import read_data_mesh
from tissuereg.io.stores import store_of
from tissuereg.simulation.motion import Motion, motion_of
from tissuereg.simulation.recipe import Recipe, recipe_of
from tissuereg.simulation.sampling import Event, EventSampler, EventSettings, linear_answers
from tissuereg.simulation.settings import DATA_SET
from tissuereg.simulation.solve import Simulator

#: Most iterations of a member: one that needs more is far beyond what tissue does; it fails instead of delaying others.
SOLVE_ITERATIONS = 150
SOLVE = {"tolerance": 1e-6, "max_iterations": SOLVE_ITERATIONS}

#: Why a member fails that the first, nearly linear pass could not answer.
_NO_LINEAR_ANSWER = "no linear answer to its load, so that its size is unknown"

#: The last maker of this process, by the fingerprint of its data set.
_MAKERS: dict[str, "ChunkMaker"] = {}
_MAKING = threading.Lock()


@dataclass(frozen=True)
class ChunkTask:
    """Input of a worker that makes one chunk (the simulations of one file) of a data set.

    `recipe`: content of the recipe's file; `mark`: fingerprint (SHA-256, hexadecimal) of recipe, seed, mesh and
    version; `seed`: seed of the data set; `number`: number of the chunk, from 0 on; `destination`: folder (absolute) or
    URL of the data set, which holds its mesh already; `threads`: threads to use; 0 takes all cores. The chunk does not
    depend on it.
    """

    recipe: dict[str, Any]
    mark: str
    seed: int
    number: int
    destination: str
    threads: int = 1


@dataclass(frozen=True, eq=False)
class ChunkReport:
    """Summary of a chunk (the simulations, or members, of one file) that has been written.

    `number`: number of the chunk, from 0 on; `members`: number of members that found equilibrium; `failed`: index of
    every other member in the data set, with the reason; `seconds`: wall time of the task in s; `n_bytes`: size of its
    file in bytes; `sha256`: SHA-256 of its file, hexadecimal; `made`: whether it was made now; False if an intact file
    was there already; `motion`: displacement statistics of its members.
    """

    number: int
    members: int
    failed: list[tuple[int, str]]
    seconds: float
    n_bytes: int
    sha256: str
    made: bool
    motion: Motion


class ChunkMaker:
    """Generator of the chunks (files of simulations) of one data set; the mesh is analysed once.

    `recipe`: recipe of the data set; `mesh`: its mesh; `seed`: seed of all random numbers.
    """

    def __init__(self, recipe: Recipe, mesh: Mesh, seed: int) -> None:
        self.recipe = recipe
        self.seed = seed
        self.simulator = Simulator(mesh, element=recipe.data.element)
        data, extent = recipe.data, mesh.extent
        radius = (data.radius_mm[0] / extent, data.radius_mm[1] / extent)
        settings = EventSettings(data.n_patches, radius, data.body_force_share, data.plate_share, data.gravity_share)
        self._sampler = EventSampler(mesh, settings)

    def make(
        self,
        number: int,
        threads: int = 0,
        progress: Callable[[int], None] | None = None,
        rows: IntArray | None = None,
    ) -> Chunk:
        """Return a chunk: simulations (members) under random loads, or some of its members.

        `number`: its number, from 0 on; `threads`: threads to use; 0 takes all cores. The chunk does not depend on it;
        `progress`: called with the number of members of this chunk that are done; `rows` int64 (k,): members of the
        chunk that are wanted, ascending, all by default. Each is the same, bit for bit, with the others or without: all
        loads are drawn, and only these are solved. Result: displacement (n_solved, n_nodes, 3), float32, mm, and
        parameters of the members that found equilibrium, and the others with their reasons. Raises `EnsembleError` if
        more than half of at least eight members fail.
        """
        recipe = self.recipe
        rng = np.random.default_rng([self.seed, 3, number])
        first = number * recipe.data.chunk
        n = min(recipe.data.chunk, recipe.data.members - first)
        wanted_rows = np.arange(n) if rows is None else rows
        young = rng.uniform(*recipe.material.young_kpa, n)[wanted_rows]
        softest = Material(recipe.material.young_kpa[0], recipe.material.poisson)
        events, size, wanted = self.events(softest, n, rng, threads, wanted_rows)
        size = size * young / recipe.material.young_kpa[0]  # the wanted motion holds at the member's own modulus
        materials = [Material(y, recipe.material.poisson) for y in young]
        displacement, lost = self._solved(events, size, materials, threads, progress)
        for _ in range(DATA_SET.again):
            largest = np.linalg.norm(displacement, axis=2).max(axis=1)
            far = np.flatnonzero(largest > recipe.data.most_mm)  # failed members are NaN
            if not len(far):
                break
            less = DATA_SET.below * recipe.data.most_mm / largest[far]
            size[far], wanted[far] = size[far] * less, wanted[far] * less
            again = [events[i] for i in far], size[far], [materials[i] for i in far]
            displacement[far], failed_again = self._solved(*again, threads)
            lost |= {int(far[i]): reason for i, reason in failed_again.items()}
        else:
            largest = np.linalg.norm(displacement, axis=2).max(axis=1)
            far = np.flatnonzero(largest > recipe.data.most_mm)
            lost |= {int(i): f"moves {largest[i]:.1f} mm, farther than [data] most_mm" for i in far}
        index = first + wanted_rows
        solved = np.array([i for i in range(len(index)) if i not in lost], dtype=np.int64)
        failed = [(int(index[i]), lost[i]) for i in sorted(lost)]
        if len(index) >= DATA_SET.few and len(solved) < len(index) / 2:
            message = (
                f"at least half of a chunk must find equilibrium, {len(solved)} of {len(index)} did; "
                "lower [data] largest_mm"
            )
            raise EnsembleError(message, dropped=failed)
        columns: dict[str, npt.NDArray[Any]] = {
            "young_kpa": young,
            "poisson": np.full(len(index), recipe.material.poisson),
            "linear_largest_mm": wanted,
            **self._sampler.columns(events, size),
        }
        fields: Fields = displacement[solved].astype(np.float32)
        kept = {name: column[solved] for name, column in columns.items()}
        return Chunk(number, index[solved], fields, kept, failed)

    def _solved(
        self,
        events: list[Event],
        size: FloatArray,
        materials: list[Material],
        threads: int,
        progress: Callable[[int], None] | None = None,
    ) -> tuple[FloatArray, dict[int, str]]:
        """Return the displacement (n, n_nodes, 3) of the body under n events, mm, and the reasons, by row, of failures.

        `events`: random loads of unit size; `size` (n,): factor on each, mN; `materials`: material for each;
        `progress`: called with the number of events done. Displacements without equilibrium are NaN.
        """
        loads = [event.load(self.simulator, s) for event, s in zip(events, size, strict=True)]
        found = self.simulator.solve_many(loads, materials, threads=threads, progress=progress, **SOLVE)
        displacement, lost = found.displacement, dict(found.failed)
        for member in np.flatnonzero(size <= 0.0):
            displacement[member], lost[int(member)] = np.nan, _NO_LINEAR_ANSWER
        return displacement, lost

    def events(
        self, material: Material, n: int, rng: np.random.Generator, threads: int, rows: IntArray | None = None
    ) -> tuple[list[Event], FloatArray, FloatArray]:
        """Return k random loads of unit size (events), their sizes (k,) in mN, and their displacements (k,) in mm.

        A size is the factor on the load; the displacement is the largest one of a node in the linear solution with that
        size. `material`: material of the body in it; `n`: number of events drawn; `rng`: source of random numbers;
        `rows` int64 (k,): the events that are wanted, all n by default.
        """
        chosen = np.arange(n) if rows is None else rows
        drawn = [self._sampler.draw(rng) for _ in range(n)]
        wanted = rng.uniform(*self.recipe.data.largest_mm, n)[chosen]
        events = [drawn[row] for row in chosen]
        _, unit = linear_answers(self.simulator, events, material, threads=threads)
        return events, unit * wanted, wanted


def data_mark(recipe: Recipe, mesh: Mesh, seed: int) -> str:
    """Return the fingerprint (SHA-256, hexadecimal) of recipe (without ``[train]``), seed, mesh and version."""
    identity = {k: v for k, v in recipe.raw.items() if k != "train"}
    text = json.dumps([CHUNK_SCHEMA, identity, seed, mesh.digest(), __version__], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def make_one_chunk(task: ChunkTask, progress: Callable[[int], None] | None = None) -> ChunkReport:
    """Make a chunk (a file of simulations) and write it, or check that an intact file is there; return its summary.

    Safe to be called again, and by several processes at once: all write the same bytes, each whole or not at all.
    `task`: recipe, seed, number and folder of the chunk; `progress`: called with the number of members (simulations) of
    this chunk that are done. Result: a few kB. Raises `EnsembleError` if more than half of a chunk of at least eight
    members fails; `ExperimentError` if the destination holds another mesh, or this process another version, than the
    task was made for; `FormatError` if the chunk is there but spoilt, or the mesh is; `OutputError` if it cannot be
    written.
    """
    start = time.perf_counter()
    store, name = store_of(task.destination), chunk_name(task.number)
    maker = chunk_maker(task)
    made = not store.exists(name)
    if made:
        chunk = maker.make(task.number, task.threads, progress)
        content = pack_chunk(chunk, task.mark, __version__)
        store.write(name, content)
    else:
        content = store.read(name)
        chunk = read_chunk(store, task.number, maker.simulator.mesh.n_nodes, task.mark, content)
    return ChunkReport(
        task.number,
        len(chunk.index),
        chunk.failed,
        time.perf_counter() - start,
        len(content),
        hashlib.sha256(content).hexdigest(),
        made,
        motion_of(chunk.displacement),
    )


def chunk_maker(task: ChunkTask) -> ChunkMaker:
    """Return the chunk generator of a task's data set; it stays in this process for the next task."""
    with _MAKING:
        maker = _MAKERS.get(task.mark)
        if maker is None:
            maker = _maker_of(task)
            _MAKERS.clear()  # a worker is busy with one data set; a maker holds hundreds of MB
            _MAKERS[task.mark] = maker
        return maker


def _maker_of(task: ChunkTask) -> ChunkMaker:
    recipe = recipe_of(task.recipe, "recipe")
    store = store_of(task.destination)
    mesh = read_data_mesh(store)
    if data_mark(recipe, mesh, task.seed) != task.mark:
        message = (
            f"{store.url} must hold the mesh that the task was made for, and this process tissuereg of the same "
            f"version; here is {__version__}"
        )
        raise ExperimentError(message, where=store.url)
    return ChunkMaker(recipe, mesh, task.seed)
