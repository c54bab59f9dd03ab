"""Timings by stage, with work counters (iterations, solves, factorisations) that explain them.

Every row of the result is a dict: name, sizes, repeats, median and 99th percentile of the total time, median of each
stage, counters, residual, peak memory. The stages add up to the total of each repeat.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.choices import Element
from tissuereg._base.clock import Clock
from tissuereg._base.machine import n_cores, peak_mib
from tissuereg.cli.benchmark.step import StepSettings, step_rows
from tissuereg.io.problems import Problem, read_problem
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.registration.contacts.body import forget_bodies
from tissuereg.registration.register import register
from tissuereg.registration.settings import RegisterSettings
from tissuereg.simulation.sampling import EventSampler, linear_answers
from tissuereg.simulation.solve import Simulator

#: Sizes of the ES-MDA updates: latents (or parameters), observations, members.
ESMDA_SIZES = ((26, 45, 100), (26, 300, 1000))

Row = dict[str, Any]


#: One repeat: times of its stages in s, and its report with the work counters.
_Repeat = tuple[dict[str, float], dict[str, Any]]


@dataclass(frozen=True)
class BenchSettings(StepSettings):
    """Settings of all timings; `repeats` is the number of timed runs of each row, after one that is not counted.

    `elements`: finite elements of the solves; `problems`: problem files that are solved instead of the phantom;
    `members`: number of solves in the ensemble. The other fields are those of the timings of a registration step.
    """

    elements: tuple[Element, ...] = ("tet4", "tet10")  # of the solves
    problems: tuple[str, ...] = ()  # problem files to solve instead of the phantom
    members: int = 32  # of the ensemble


def bench_solve(settings: BenchSettings) -> list[Row]:
    """Time whole static solves, one row per problem and element type; nothing is cached between repeats."""
    rows = []
    for name, problem in _problems(settings):
        for element in settings.elements:
            once = _one_solve(problem, element, settings)
            rows.append(_row(f"solve/{name}/{element}", problem.mesh.n_nodes, settings, once))
    return rows


def bench_ensemble(settings: BenchSettings) -> list[Row]:
    """Time many solves on the phantom under random loads; one row per element type, with the analysis as a stage."""
    mesh = phantom_mesh()
    rows = []
    for element in settings.elements:
        name = f"ensemble/phantom/{element}/{settings.members}"
        rows.append(_row(name, mesh.n_nodes, settings, _one_ensemble(element, settings)))
    return rows


def bench_esmda(settings: BenchSettings) -> list[Row]:
    """Time one ES-MDA update; one row per size in `ESMDA_SIZES` and type of noise covariance, diagonal or dense."""
    rows = []
    for sizes in ESMDA_SIZES:
        for kind in ("diagonal", "dense"):
            name = f"esmda/{'x'.join(map(str, sizes))}/{kind}"
            rows.append(_row(name, None, settings, _one_update(*sizes, kind, settings)))
    return rows


def bench_register(settings: BenchSettings) -> list[Row]:
    """Time whole registrations of the phantom, and single steps of a `Registrar` that is prepared before.

    There are two rows for the search for contacts (the first registration on a mesh, and a later one), one for the
    shipped network if there is one, and the rows of `step_rows`.
    """
    event = make_event(seed=settings.seed)
    simulator = Simulator(event.mesh)
    simulation = simulator.solve(event.load, event.material, threads=settings.threads).displacement

    def once(model: str | None = None) -> _Repeat:
        result = register(
            event.mesh,
            event.markers,
            model=model,
            simulation=simulation,
            targets={"lesion": LESION_MM},
            seed=settings.seed,
            settings=RegisterSettings(settings.threads),
        )
        return {name: spent for name, spent in result.seconds.items() if name != "total"}, {}

    def first_on_the_mesh() -> _Repeat:
        forget_bodies()
        return once()

    rows = [
        _row("register/phantom/contacts-first", event.mesh.n_nodes, settings, first_on_the_mesh),
        _row("register/phantom/contacts", event.mesh.n_nodes, settings, once),
    ]
    if shipped_model_folder().exists():
        rows.append(_row("register/phantom/shipped", event.mesh.n_nodes, settings, lambda: once("phantom")))
    return rows + step_rows(settings)


#: The benchmarks, by their names on the command line.
BENCHES: dict[str, Callable[[BenchSettings], list[Row]]] = {
    "solve": bench_solve,
    "ensemble": bench_ensemble,
    "esmda": bench_esmda,
    "register": bench_register,
}


def _problems(settings: BenchSettings) -> list[tuple[str, Problem]]:
    if settings.problems:
        return [(Path(path).stem, read_problem(path)) for path in settings.problems]
    event = make_event(seed=settings.seed)
    return [("phantom", Problem(event.mesh, event.material, event.load))]


def _one_solve(problem: Problem, element: Element, settings: BenchSettings) -> Callable[[], _Repeat]:
    def once() -> _Repeat:
        clock = Clock()
        with clock.stage("analyse"):
            simulator = Simulator(problem.mesh, element=element)
        with clock.stage("iterate"):
            found = simulator.solve(problem.load, problem.material, threads=settings.threads)
        clock.seconds["factor"] = float(found.report["seconds"]["factor"])
        clock.seconds["iterate"] -= clock.seconds["factor"]
        return clock.seconds, found.report

    return once


def _one_ensemble(element: Element, settings: BenchSettings) -> Callable[[], _Repeat]:
    mesh, material = phantom_mesh(), make_event(seed=settings.seed).material
    prepared = Simulator(mesh, element=element)
    sampler, rng = EventSampler(mesh), np.random.default_rng([settings.seed, 6])
    events = [sampler.draw(rng) for _ in range(settings.members)]
    _, unit = linear_answers(prepared, events, material, threads=settings.threads)
    sizes = unit * rng.uniform(2.0, 0.1 * mesh.extent, settings.members)
    loads = [event.load(prepared, size) for event, size in zip(events, sizes, strict=True)]
    forces = np.stack([nodal for nodal in map(prepared.forces, loads) if nodal is not None])
    body_forces = np.stack([load.body_force for load in loads])
    young = np.full(settings.members, material.young_array[0])
    poisson = np.full(settings.members, material.poisson_array[0])

    def once() -> _Repeat:
        clock = Clock()
        with clock.stage("analyse"):
            simulator = Simulator(mesh, element=element)
        with clock.stage("solve"):
            found = simulator.body.solve_many(
                young, poisson, forces=forces, body_force=body_forces, tolerance=1e-6, threads=settings.threads
            )
        report = _summed([dict(report) for report in found.reports if report])
        return clock.seconds, {**report, "failed": len(found.failed)}

    return once


def _summed(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the work counters of all solves of an ensemble, added up, and the largest residual."""
    names = ("iterations", "solves", "factorisations")
    counters = {name: sum(int(report[name]) for report in reports) for name in names}
    return {**counters, "residual": max((report["residual"] for report in reports), default=None), "analyses": 1}


def _one_update(n_latent: int, n_obs: int, n_members: int, kind: str, settings: BenchSettings) -> Callable[[], _Repeat]:
    rng = np.random.default_rng([settings.seed, 7])
    latents = rng.standard_normal((n_latent, n_members))
    predicted = rng.standard_normal((n_obs, n_latent)) @ latents
    observed, draws = rng.standard_normal(n_obs), rng.standard_normal((n_obs, n_members))
    std = np.full(n_obs, 0.1)

    def once() -> _Repeat:
        clock = Clock()
        with clock.stage("prepare"):
            noise = _core.Noise.diagonal(std) if kind == "diagonal" else _core.Noise.dense(np.diag(std**2))
            step = _core.Step(predicted, observed, noise, draws, alpha=5.0, threads=settings.threads)
        with clock.stage("apply"):
            step.apply(latents)
        return clock.seconds, {}

    return once


def _row(name: str, n_nodes: int | None, settings: BenchSettings, once: Callable[[], _Repeat]) -> Row:
    once()  # the first run warms caches and page tables
    runs, totals = [], []
    for _ in range(settings.repeats):
        start = time.perf_counter()
        runs.append(once())
        totals.append(time.perf_counter() - start)
    (stages, report), seconds = runs[-1], [spent for spent, _ in runs]
    return {
        "name": name,
        "n_nodes": n_nodes,
        "threads": settings.threads or n_cores(),
        "repeats": settings.repeats,
        "median_s": float(np.median(totals)),
        "p99_s": float(np.percentile(totals, 99)),
        "stages_s": {stage: float(np.median([one[stage] for one in seconds])) for stage in stages},
        "counters": {key: report.get(key) for key in ("iterations", "solves", "factorisations", "analyses")},
        "failed": report.get("failed", 0),
        "residual": report.get("residual"),
        "peak_mib": peak_mib(),
    }
