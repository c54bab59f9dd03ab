"""Timings of one registration step by stage, and a lower bound from its multiply-adds.

Ensembles have N_e = 100 members and N_a = 5 assimilations as in the paper, and in one row the defaults; 15 markers lie
on the free surface, with one target. All that `Registrar` prepares is ready before. Many random sets of markers are
timed, each with another event: a simulation, and a true displacement with other loads and another stiffness.
"""

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tissuereg._base.arrays import FloatArray
from tissuereg._base.machine import n_cores, peak_mib
from tissuereg.body.mesh import Mesh
from tissuereg.cli.benchmark.network import write_random_table2
from tissuereg.errors import ModelError
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.phantom.event import shipped_recipe
from tissuereg.registration.learned.card import read_card
from tissuereg.registration.learned.network import kept_network
from tissuereg.registration.registrar import Registrar
from tissuereg.registration.settings import RegisterSettings, SmootherSettings
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.pairs import simulated_pairs
from tissuereg.simulation.recipe import PairsRecipe


@dataclass(frozen=True)
class PaperStep:
    """Constants of the timed registration step: the paper's setting, and how its time is measured.

    `n_members`, `n_steps`: ensemble size and number of assimilations; `n_markers`: number of markers; `n_warm`:
    registrations of each set of markers that are not counted; `side`, `products`: rows of the square matrices, and
    number of the products of two such, by which the machine's speed is measured.
    """

    n_members: int = 100  # of the ensemble
    n_steps: int = 5  # assimilations
    n_markers: int = 15  # of a set
    n_warm: int = 2  # registrations of each set that do not count
    side: int = 1024  # of the matrices whose product gives the machine's rate
    products: int = 12  # of which the fastest counts


PAPER = PaperStep()


@dataclass(frozen=True)
class StepSettings:
    """Settings of the timings of a registration step.

    `repeats`: timed registrations of every set of markers; `threads`: threads to use, 0 takes all cores; `seed`: seed
    of markers and events; `model`: folder of the model, None for the shipped one; `table2`: folder of a network of the
    paper's Table II, None for one with random weights; `n_sets`: sets of markers over which times are taken.
    """

    repeats: int = 10  # timed registrations of every set of markers
    threads: int = 0  # 0: all cores
    seed: int = 0  # of places and states
    model: str | None = None  # folder of the model of ``step/shipped``; by default the shipped one
    # Folder of the model of ``step/table2``; by default a network of that size with random weights.
    table2: str | None = None
    n_sets: int = 20  # random sets of markers


def step_rows(settings: StepSettings) -> list[dict[str, Any]]:
    """Time one step: rows ``step/default``, ``step/graph``, ``step/shipped`` and ``step/table2``.

    They are of the shipped model with the default settings, of the shipped graph network (these two where no other
    model is asked for), of the shipped model, and of a network of Table II.
    Each row is a dict with the times in s, by stage and in total. Raises ModelError if a model was trained on none of
    the phantom's meshes, or its decoder cannot be restricted to the needed nodes.
    """
    paper = SmootherSettings(n_members=PAPER.n_members, n_steps=PAPER.n_steps)
    folder = Path(settings.model) if settings.model else shipped_model_folder()
    asked = [("step/shipped", folder, paper)]
    if settings.model is None:
        graph = shipped_model_folder("phantom-graph")
        asked = [("step/default", folder, SmootherSettings()), ("step/graph", graph, paper), *asked]
    rows = [_row(name, one, how, settings, "trained") for name, one, how in asked if one.exists()]
    with _table2(settings) as (large, weights):
        return [*rows, _row("step/table2", large, paper, settings, weights)]


def sgemm_rate(threads: int) -> float:
    """Return the multiply-adds per second of the fastest of several float32 matrix products on `threads` threads."""
    left, right = (np.random.default_rng(k).random((PAPER.side, PAPER.side), dtype=np.float32) for k in (0, 1))
    product = np.empty_like(left)
    spent = []
    with threadpool_limits(limits=threads, user_api="blas"):
        for _ in range(PAPER.products):
            start = time.perf_counter()
            np.matmul(left, right, out=product)
            spent.append(time.perf_counter() - start)
    return PAPER.side**3 / min(spent)


@contextmanager
def _table2(settings: StepSettings) -> Iterator[tuple[Path, str]]:
    """Yield the folder of a network of Table II's size, and text that states where its weights are from."""
    if settings.table2:
        yield Path(settings.table2), "trained"
        return
    with tempfile.TemporaryDirectory() as folder:
        write_random_table2(phantom_mesh(), Path(folder), settings.seed)
        yield Path(folder), "random: the time does not depend on the values"


def _mesh_of(folder: Path) -> Mesh:
    digest = read_card(folder)["mesh_digest"]
    for mesh in (phantom_mesh(), phantom_mesh("small")):
        if mesh.digest() == digest:
            return mesh
    message = f"the model in {folder} must know a mesh of the phantom, to be timed; it knows another one"
    raise ModelError(message, where=str(folder))


def _row(name: str, folder: Path, smoother: SmootherSettings, settings: StepSettings, weights: str) -> dict[str, Any]:
    threads = settings.threads or n_cores()
    mesh = _mesh_of(folder)
    network = kept_network(folder, mesh, threads)
    rng = np.random.default_rng([settings.seed, 8])
    how = RegisterSettings(threads, smoother=smoother)
    made, totals, decoded, stages, doubted = [], [], [], [], 0
    states = list(zip(*_states(mesh, settings.n_sets, settings.seed, threads), strict=True))
    for number in range(settings.n_sets):
        simulation, truth = states[number % len(states)]
        places, weights_of = _markers(mesh, rng)
        start = time.perf_counter()
        registrar = Registrar(mesh, places, network, {"inside": _inside(mesh, rng)}, settings=how)
        made.append(time.perf_counter() - start)
        for turn in range(PAPER.n_warm + settings.repeats):
            measured = places + weights_of @ truth + 0.1 * rng.standard_normal(places.shape)
            before = registrar.n_decoded
            start = time.perf_counter()
            result = registrar.register(measured, simulation)
            spent = time.perf_counter() - start
            if turn < PAPER.n_warm:
                continue
            totals.append(spent)
            doubted += not result.trust.ok
            stages.append(result.seconds)
            decoded.append((registrar.n_decoded - before, registrar.multiply_adds))
    rate = sgemm_rate(threads)
    work = float(np.median([members * each for members, each in decoded]))
    floor = work / rate
    median = float(np.median(totals))
    return {
        "name": name,
        "n_nodes": mesh.n_nodes,
        "threads": threads,
        "repeats": len(totals),
        "median_s": median,
        "p99_s": float(np.percentile(totals, 99)),
        "fastest_s": float(min(totals)),
        "stages_s": {
            stage: float(np.median([one[stage] for one in stages])) for stage in stages[0] if stage != "total"
        },
        "made_s": float(np.median(made)),
        "counters": {"iterations": None, "solves": None, "factorisations": None, "analyses": smoother.n_steps},
        "members": smoother.n_members,
        "markers": PAPER.n_markers,
        "marker_sets": settings.n_sets,
        "members_decoded": int(np.median([members for members, _ in decoded])),
        "doubted": doubted,
        "weights": weights,
        "multiply_adds": work,
        "sgemm_multiply_adds_per_s": rate,
        "floor_s": floor,
        "times_floor": median / floor,
        "residual": None,
        "failed": 0,
        "peak_mib": peak_mib(),
    }


def _markers(mesh: Mesh, rng: np.random.Generator) -> tuple[FloatArray, Any]:
    """Return random places (n, 3), mm, on the free surface, and sparse weights (n, n_nodes) that interpolate there."""
    from scipy import sparse

    held = np.isin(mesh.surface, mesh.node_sets["fixed"]).any(axis=1)
    triangles = mesh.surface[~held]
    corners = mesh.nodes[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = triangles[rng.choice(len(triangles), PAPER.n_markers, replace=False, p=areas / areas.sum())]
    shares = rng.dirichlet(np.ones(3), PAPER.n_markers)
    rows = (np.repeat(np.arange(PAPER.n_markers), 3), chosen.ravel())
    return np.einsum("kc,kcx->kx", shares, mesh.nodes[chosen]), sparse.csr_array(
        (shares.ravel(), rows), (PAPER.n_markers, mesh.n_nodes)
    )


def _inside(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    return np.asarray(mesh.nodes[mesh.tets[rng.integers(len(mesh.tets))]].mean(axis=0))


def _states(mesh: Mesh, n_states: int, seed: int, threads: int) -> tuple[FloatArray, FloatArray]:
    """Return simulated and true displacements, (n, n_nodes, 3), mm, under random loads as in the shipped model's data.

    The truth has the same elements, other loads, another modulus and a stiff inclusion. Loads without an equilibrium
    are left out, so that there may be fewer than `n_states`.
    """
    recipe = shipped_recipe()
    recipe = replace(recipe, pairs=PairsRecipe(members=n_states, element="tet4"))
    return simulated_pairs(ChunkMaker(recipe, mesh, seed), threads)
