"""Events that the models never saw, as they are measured: places and noise are drawn, the truth is known."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import free_surface
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import EnsembleError
from tissuereg.io.atomic import atomic_file
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.pairs import simulated_pairs
from tissuereg.simulation.recipe import read_recipe, recipe_of

HERE = Path(__file__).resolve().parent
RECIPE = HERE / "foreign.toml"

#: Folders of foreign pairs: those that calibrate, and those that are asked.
FOREIGN_PARTS = ("development", "test")

N_MARKERS, N_TARGETS, STD = 15, 20, 0.1

#: Iterations after which a foreign truth fails.
_ITERATIONS = 60

#: Events of another organ, and the seed of its recipe.
_OTHERS, _OTHER_SEED = 60, 5


@dataclass(frozen=True)
class Case:
    """One event as it is measured; lengths in mm.

    `cluster`: what it shares with others of its set; `reference`, `measured` (15, 3): markers; `targets`, `moved`
    (n_targets, 3): inner points at rest, and their true displacement; `simulation` (n_nodes, 3): given to the method,
    or None; `start` (n_targets, 3): displacement of the targets before registration, by the simulation or zero.
    """

    cluster: int
    reference: FloatArray
    measured: FloatArray
    targets: FloatArray
    moved: FloatArray
    simulation: FloatArray | None
    start: FloatArray


def drawn(
    mesh: tr.Mesh,
    truth: FloatArray,
    simulation: FloatArray | None,
    seed: list[int],
    cluster: int,
    *,
    given: bool = True,
) -> Case:
    """Return a shape as it is measured: random markers on the free surface, random targets inside.

    `given`: whether the method gets the simulation; the error before registration is that of it either way.
    """
    rng = np.random.default_rng(seed)
    free, shares = free_surface(mesh)
    chosen = mesh.nodes[free[rng.choice(len(free), N_MARKERS, p=shares)]]
    reference = np.einsum("pc,pcx->px", rng.dirichlet(np.ones(3), N_MARKERS), chosen)
    inside = mesh.nodes[mesh.tets[rng.choice(mesh.n_tets, N_TARGETS, p=mesh.volumes / mesh.volumes.sum())]]
    inner = np.einsum("pc,pcx->px", rng.dirichlet(np.ones(4), N_TARGETS), inside)
    markers = MarkerObservation(mesh, reference, tuple(str(i) for i in range(N_MARKERS)))
    targets = TargetObservation(mesh, {str(i): place for i, place in enumerate(inner)})
    truth = truth.astype(np.float64)
    simulated = None if simulation is None else simulation.astype(np.float64)
    measured = reference + markers.predict(truth[markers.nodes]) + STD * rng.standard_normal(reference.shape)
    moved = targets.predict(truth[targets.nodes])
    start = np.zeros_like(moved) if simulated is None else targets.predict(simulated[targets.nodes])
    return Case(cluster, reference, measured, inner, moved, simulated if given else None, start)


def known(data: Path, n: int) -> list[Case]:
    """Return shapes of a data set's test split, each a cluster, without a simulation."""
    there = tr.open_dataset(data)
    return [
        drawn(there.mesh, there.displacement[row], None, [41, i], i) for i, row in enumerate(there.split["test"][:n])
    ]


def foreign(mesh: tr.Mesh, folder: Path, first: int, *, given: bool) -> list[Case]:
    """Return the pairs of the test part of `folder` from file number `first` on; a file is a cluster."""
    cases: list[Case] = []
    for path in sorted((folder / FOREIGN_PARTS[1]).glob("pairs_*.npz")):
        number = int(path.stem.split("_")[1])
        if number >= first:
            with np.load(path) as pairs:
                both = list(zip(pairs["simulation_mm"], pairs["truth_mm"], strict=True))
            cases += [drawn(mesh, b, a, [42, number, i], number, given=given) for i, (a, b) in enumerate(both)]
    return cases


def demo(n: int, *, given: bool) -> list[Case]:
    """Return the demo's event, of one true field, with other markers and noise in each; the lesion is the target."""
    event = make_event(seed=0)
    simulation = tr.simulate(event.mesh, event.load, event.material).displacement
    lesion = TargetObservation(event.mesh, {"lesion": LESION_MM})
    start = lesion.predict(simulation[lesion.nodes])
    cases = []
    for seed in range(n):
        one = make_event(seed=seed)
        place = np.array([LESION_MM])
        moved = one.true_lesion[None] - place
        cases.append(
            Case(seed, one.markers.reference, one.markers.measured, place, moved, simulation if given else None, start)
        )
    return cases


def of_another_organ() -> list[Case]:
    """Return markers of events on a body of another shape; targets do not count."""
    from tissuereg.phantom.breast import breast_mesh

    small = breast_mesh(700)
    turned = np.stack([-small.nodes[:, 1], small.nodes[:, 0], small.nodes[:, 2]], axis=1) * np.array([0.85, 1.15, 0.9])
    body = tr.Mesh(turned, small.tets, {"fixed": small.fixed_nodes})
    raw = read_recipe(RECIPE).raw
    raw = {**raw, "data": {**raw["data"], "members": _OTHERS, "chunk": _OTHERS}}
    fields = ChunkMaker(recipe_of(raw, "recipe"), body, _OTHER_SEED).make(0, threads=1).displacement
    return [drawn(body, field, None, [_OTHER_SEED, 31, i], i) for i, field in enumerate(fields)]


def make_foreign(out: Path, numbers: Iterator[int] | range) -> None:
    """Make files of foreign pairs; those that are there are kept.

    Even numbers are of development, odd ones of the test. Cost: seconds a pair.
    """
    recipe = read_recipe(RECIPE)
    maker = ChunkMaker(recipe, recipe.mesh(), recipe.seed)
    for number in numbers:
        path = out / FOREIGN_PARTS[number % 2] / f"pairs_{number:04d}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            continue
        maker.seed = recipe.seed + 1000 * number
        try:
            simulations, truths = simulated_pairs(maker, 1, max_iterations=_ITERATIONS)
        except EnsembleError as error:
            print(f"{path.name}: {error}", flush=True)
            continue
        with atomic_file(path) as draft, draft.open("wb") as stream:
            np.savez(stream, simulation_mm=simulations.astype(np.float32), truth_mm=truths.astype(np.float32))
        print(f"{path.name}: {len(truths)} pairs", flush=True)
