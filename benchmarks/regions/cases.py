"""The registrations of the bench, by family of truth: a body, markers, and targets whose motion is known."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import SHARED
from loadfree.events import BODIES, Event, events_of, read_body, read_set, true_load
from loadfree.layouts import LAYOUTS as EVERY_LAYOUT
from loadfree.layouts import NOISE_MM, markers
from loadfree.reference import FOLDER, PROBLEMS, read_reference
from real import hydrogel
from support.meshes import kuhn
from tissuereg.body.observe import TargetObservation

#: Events of each body of `loadfree`, and layouts of markers.
N_EVENTS, LAYOUTS = 8, ("spread", "far")

#: Draws of markers of each recording. Draws 0 and 1 were used for development.
N_DRAWS = 5

#: The gel around a cell: its folder, noise of a bead, place of the cell, width of the view, all in um (read as mm).
CELL, CELL_STD, CELL_MIDDLE, VIEW = (
    SHARED / "data" / "cell-gel",
    (0.037, 0.037, 0.18),
    (76.0, 81.0, 76.0),
    (150.0, 140.0),
)


@dataclass(frozen=True, eq=False)
class Case:
    """One registration: what is given, and the truth.

    `body`: body, or its mesh; `markers`: markers; `targets`, `truth` (k, 3): places before and after; `noise` (3,):
    standard deviation of the truth itself; `cluster`: body and number of the event, on which `body_of` looks.
    """

    body: tr.Body | tr.Mesh
    markers: tr.Markers
    targets: np.ndarray
    truth: np.ndarray
    noise: tuple[float, float, float]
    cluster: str


Make = Callable[[], Case]

#: The mesh that reference problems share.
REFERENCE_MESH = "dome_4k"


def body_of(event: str) -> str:
    """Return the body of an event, "<body>" or "<body> <number>".

    >>> body_of("inner dome 12"), body_of("gel"), body_of("dome_4k_pull 1")
    ('inner dome', 'gel', 'dome_4k')
    """
    name = event.rstrip("0123456789").rstrip() if " " in event else event
    return REFERENCE_MESH if name.startswith(REFERENCE_MESH) else name


#: Events whose truth is four-node elements at a Poisson's ratio of 0.49 on the user's own mesh, of each body.
N_LOCKED = 4

#: What no load on the believed body explains, and the bodies of such events.
INNER, INNER_BODIES = ("fibres", "growth"), ("dome", "slab", "beam")

#: Pushes of the slab by this much, mm: more than its thickness.
N_PUSHES, PUSH_MM = 4, 55.0

#: Noise of markers that is stated as that of `loadfree`, mm, and events of each body.
NOISIER_MM, N_NOISY = 1.0, 4


def families() -> dict[str, list[Make]]:
    """Return the cases of each family that can be made here, each as a function that makes it."""
    found: dict[str, list[Make]] = {}
    for count in (20, 60):
        if (folder := SHARED / "data" / "hydrogel").is_dir():
            found[f"gel under a ball, {count} beads"] = [partial(_gel, folder, count, seed) for seed in range(N_DRAWS)]
        if CELL.is_dir():
            found[f"gel around a cell, {count} beads"] = [partial(_cell, count, seed) for seed in range(N_DRAWS)]
    if (folder := SHARED / "cases").is_dir():
        found["organ of another solver"] = [partial(_organ, folder)]
    if FOLDER.is_dir():
        found["reference problems"] = [
            partial(_event, read_reference, name, number, layout, ("tet4", True))
            for name in PROBLEMS[:3]
            for number in range(2)
            for layout in ("spread", "random", "near")
        ]
    for layout in LAYOUTS:
        found[f"five bodies, markers {layout}"] = list(_free(layout, N_EVENTS))
    noisier = list(_free("spread", N_NOISY))
    found[f"the same, noise {NOISIER_MM:g} mm stated as {NOISE_MM:g}"] = [partial(_noisier, make) for make in noisier]
    found["coarse body near incompressible, locked"] = [
        partial(_locked, name, number) for name in BODIES[:4] for number in range(0, 2 * N_LOCKED, 2)
    ]
    for kind in INNER:
        found[f"three bodies, {kind}"] = [
            partial(_inner, name, event.number, layout)
            for name in INNER_BODIES
            for event in events_of(read_set(name, "inner"), "dev")
            if event.kind == kind
            for layout in ("spread", "random")
        ]
    pushes = [(number, layout) for number in range(N_PUSHES) for layout in EVERY_LAYOUT]
    found[f"slab pushed by {PUSH_MM:g} mm"] = [partial(_pushed, *push) for push in pushes]
    return found


def _free(layout: str, n_events: int) -> Iterator[Make]:
    for name in BODIES:
        for event in events_of(read_body(name), "dev")[:n_events]:
            yield partial(_event, read_body, name, event.number, layout, ("auto", False))


def _event(read, name: str, number: int, layout: str, how: tuple[str, bool]) -> Case:
    body = read(name)
    event = next(event for event in body.events if event.number == number)
    poisson = event.description["poisson"] if how[1] else 0.45
    given = tr.Body(body.mesh, tr.Material(10.0, poisson), how[0])
    truth = body.targets + event.targets
    return Case(given, markers(body, event, layout), body.targets, truth, (0.0,) * 3, f"{name} {number}")


def _gel(folder: Path, count: int, seed: int) -> Case:
    beads = hydrogel.draw(folder, count, seed)
    seen = tr.Markers(*beads.markers, np.tile(hydrogel.STD_MM, (count, 1)))
    return Case(hydrogel.gel(), seen, *beads.targets, hydrogel.STD_MM, "gel")


def _cell(count: int, seed: int) -> Case:
    with np.load(CELL / "beads.npz") as beads:
        before, after = (beads[name].astype(np.float64) for name in ("reference_um", "measured_um"))
    away = np.linalg.norm(before - CELL_MIDDLE, axis=1)
    rim = np.flatnonzero((away >= 30.0) & (away <= 60.0))
    first = int(np.random.default_rng(seed).integers(len(rim)))
    some = rim[hydrogel.far_apart(before[rim], count, first)]
    inner = np.flatnonzero(away < 25.0)
    across, along = np.linspace(-1.0, VIEW[0] + 1.0, 13), np.linspace(-1.0, VIEW[1] + 1.0, 12)
    body = tr.Body(tr.Mesh(*kuhn([across, across, along])), held="free")
    seen = tr.Markers(before[some], after[some], np.tile(CELL_STD, (count, 1)))
    return Case(body, seen, before[inner], after[inner], CELL_STD, "cell")


def _organ(folder: Path) -> Case:
    mesh, seen = tr.read_mesh(folder / "organ.vtu"), tr.read_markers(folder / "markers.csv", NOISE_MM)
    targets, truth = (tr.read_targets(folder / f"{name}.csv") for name in ("targets", "truth"))
    names = list(targets)
    return Case(
        mesh, seen, np.array([targets[name] for name in names]), np.array([truth[name] for name in names]),
        (0.0,) * 3, "organ",
    )  # fmt: skip


def _noisier(make: Make) -> Case:
    case, rng = make(), np.random.default_rng(43)
    seen = case.markers
    more = np.sqrt(NOISIER_MM**2 - NOISE_MM**2) * rng.standard_normal(seen.measured.shape)
    return replace(case, markers=tr.Markers(seen.reference, seen.measured + more, NOISE_MM))


def _pushed(number: int, layout: str) -> Case:
    """Return the slab of `loadfree` under a dead traction; the truth is this package's own, on a finer mesh."""
    known, rng = read_body("slab"), np.random.default_rng([43, number])
    low, high = known.mesh.nodes.min(axis=0), known.mesh.nodes.max(axis=0)
    nodes, tets = kuhn([np.linspace(a, b, n) for a, b, n in zip(low, high, (25, 19, 8), strict=True)])
    mesh = tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(nodes[:, 0] == low[0])})
    centre = low + (high - low) * np.array([rng.uniform(0.4, 0.85), rng.uniform(0.2, 0.8), 1.0])
    off = np.linalg.norm(nodes - centre, axis=1) / rng.uniform(12.0, 25.0)
    shape = np.clip(1.0 - off**2, 0.0, None) * (nodes[:, 2] == high[2])
    moved = _moved_by(mesh, np.outer(shape / shape.sum(), (0.0, 0.0, -1.0)))
    return _seen(known, number, {"contacts": [{"centre": centre}]}, (mesh, moved), layout)


def _locked(name: str, number: int) -> Case:
    """Return an event as a plain solver has it: its true loads, elements too stiff, the user's mesh."""
    body = read_body(name)
    event = next(event for event in body.events if event.number == number)
    moved = tr.simulate(body.mesh, true_load(body, event), tr.Material(10.0, 0.49), threads=1).displacement
    return _seen(body, number, event.description, (body.mesh, moved), "spread")


def _inner(name: str, number: int, layout: str) -> Case:
    body = read_set(name, "inner")
    event = next(event for event in body.events if event.number == number)
    truth = body.targets + event.targets
    return Case(body.mesh, markers(body, event, layout), body.targets, truth, (0.0,) * 3, f"inner {name} {number}")


def _seen(body, number: int, description: dict, field: tuple[tr.Mesh, np.ndarray], layout: str) -> Case:
    """Return what is measured of a displacement field of a mesh, with pool and targets of a body of `loadfree`."""
    mesh, moved = field
    inside = TargetObservation(mesh, {str(i): place for i, place in enumerate([*body.pool, *body.targets])})
    pool, targets = np.split(inside.predict(moved[inside.nodes]), [len(body.pool)])
    event = Event(body.name, number, description, np.empty((0, 3)), pool, targets)
    truth = body.targets + targets
    return Case(body.mesh, markers(body, event, layout), body.targets, truth, (0.0,) * 3, f"{body.name} {number}")


def _moved_by(mesh: tr.Mesh, forces: np.ndarray) -> np.ndarray:
    """Return the displacement, mm, under so many times `forces` that it is at most `PUSH_MM`, within a hundredth."""
    solver, size = tr.Simulator(mesh), 200.0
    while True:
        moved = solver.solve(tr.Load(forces=size * forces), tr.Material(10.0, 0.45)).displacement
        largest = float(np.linalg.norm(moved, axis=1).max())
        if abs(largest - PUSH_MM) < 0.01 * PUSH_MM:
            return moved
        size *= min(2.0, PUSH_MM / largest)
