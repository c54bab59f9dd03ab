"""One measurement of `solver.py` in a process of its own; prints one JSON object.

    python benchmarks/speed/solver_work.py floor [--quick]
    python benchmarks/speed/solver_work.py solve PROBLEM.npz [--element tet10] [--repeats N] [--tol X]
    python benchmarks/speed/solver_work.py many PROBLEM.npz [--members N]
    python benchmarks/speed/solver_work.py reference PROBLEM.npz OUT.npz [--scale X] [--element tet10]

Threads are taken from RAYON_NUM_THREADS (all cores where absent).
"""

import argparse
import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

import tissuereg as tr
from tissuereg import _core
from tissuereg._base.machine import machine, peak_mib, versions
from tissuereg.io.problems import read_problem
from tissuereg.simulation.sampling import EventSampler, EventSettings, linear_answers
from tissuereg.simulation.solve import Simulator

COUNTERS = ("iterations", "evaluations", "solves", "factorisations", "analyses", "load_steps", "residual", "min_det_f")


def process_peak_mib() -> float | None:
    """Return this process's peak memory in MiB; `ru_maxrss` on Linux may be that of the parent before it."""
    status = Path("/proc/self/status")
    if not status.exists():
        return peak_mib()
    return int(status.read_text(encoding="utf-8").split("VmHWM:")[1].split()[0]) / 1024


def spread(seconds: list[float]) -> dict:
    """Return minimum, median and number of repeats."""
    return {"minimum": min(seconds), "median": float(np.median(seconds)), "repeats": len(seconds)}


def seconds_of(work) -> tuple[float, object]:
    start = time.perf_counter()
    answer = work()
    return time.perf_counter() - start, answer


def floor(options: argparse.Namespace) -> dict:
    """Return rates of dense products (GFLOP/s) and of memory (GB/s) on one and two threads, best of several."""
    side, rounds = (1024, 2) if options.quick else (2560, 7)
    rates: dict = {"blas": [f"{x['internal_api']} {x['version']}" for x in threadpool_info()], "side": side}
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            for name, kind in (("dgemm", np.float64), ("sgemm", np.float32)):
                a, b = (np.random.default_rng(seed).random((side, side), dtype=kind) for seed in (1, 2))
                out = np.empty_like(a)
                best = min(seconds_of(lambda a=a, b=b, out=out: np.matmul(a, b, out=out))[0] for _ in range(rounds))
                rates.setdefault(f"{name}_gflops", {})[threads] = 2e-9 * side**3 / best
        rates.setdefault("triad_gb_per_s", {})[threads] = triad(threads, 2**22 if options.quick else 2**25, rounds)
    return {**rates, "machine": machine(), "versions": versions()}


def triad(threads: int, size: int, rounds: int, chunk: int = 2**15) -> float:
    """Return the rate of a = b + s c (24 bytes a term), done in pieces that stay in the cache."""
    a, b, c = np.zeros(size), np.ones(size), np.ones(size)

    def part(index: int) -> None:
        for at in range(index * size // threads, (index + 1) * size // threads, chunk):
            piece = slice(at, at + chunk)
            np.multiply(c[piece], 3.0, out=a[piece])
            np.add(a[piece], b[piece], out=a[piece])

    with ThreadPoolExecutor(threads) as pool:
        best = min(seconds_of(lambda: list(pool.map(part, range(threads))))[0] for _ in range(rounds))
    return 24e-9 * size / best


def solve(options: argparse.Namespace) -> dict:
    """Return cold and warm times of one problem, its counters, memory, and the distance from the stored answer."""
    with np.load(options.problem) as given:
        nodes, tets, fixed = given["nodes_mm"], given["tets"].astype(np.int64), given["fixed_nodes"].astype(np.int64)
        young, poisson = np.atleast_1d(given["young_kPa"]), np.atleast_1d(given["poisson"])
        forces, reference = given["forces_mN"], given.get("displacement_mm")
    before = process_peak_mib()

    def analyse() -> tuple[_core.Body, np.ndarray]:
        body = _core.Body(nodes, tets, np.sort(fixed), element=options.element)
        padded = np.zeros((body.n_nodes, 3))
        padded[: len(forces)] = forces
        return body, padded

    def cold() -> tuple[_core.Body, _core.Solution]:
        body, padded = analyse()
        return body, body.solve(young, poisson, forces=padded, tolerance=options.tol)

    seconds, (body, found) = seconds_of(cold)
    peak = process_peak_mib()
    runs = [seconds]
    if options.repeats > 1:  # the first run warms caches and page tables
        runs = []
        for _ in range(options.repeats):
            del body, found
            seconds, (body, found) = seconds_of(cold)
            runs.append(seconds)
    answer = {
        "n_nodes": body.n_nodes,
        "n_tets": body.n_tets,
        "cold_s": spread(runs),
        "stages_s": {"analyse": body.analyse_seconds, **found.report["seconds"]},
        "counters": {name: found.report[name] for name in COUNTERS},
        "peak_mib": peak,
        "peak_before_mib": before,
        "largest_mm": float(np.linalg.norm(found.displacement, axis=1).max()),
        "difference_mm": off(found, reference),
    }
    padded, warm = analyse()[1], []
    other = -0.4 * np.roll(padded, 1, axis=1)
    for _ in range(options.repeats):
        body.solve(1.7 * young, poisson, forces=other, tolerance=options.tol)
        seconds, again = seconds_of(lambda: body.solve(young, poisson, forces=padded, tolerance=options.tol))
        warm.append(seconds)
    counters = {name: again.report[name] for name in COUNTERS}
    return {
        **answer,
        "warm_s": spread(warm),
        "warm_stages_s": again.report["seconds"],
        "warm_counters": counters,
        "warm_difference_mm": off(again, reference),
    }


def off(found: _core.Solution, reference: np.ndarray | None) -> float | None:
    """Return the largest distance between two displacement fields in mm, over the nodes of the reference."""
    if reference is None:
        return None
    return float(np.linalg.norm(found.displacement[: len(reference)] - reference, axis=1).max())


def many(options: argparse.Namespace) -> dict:
    """Return the time a member of a data set: E 10-60 kPa, one to three random patches, 2 to 25 mm to first order."""
    problem = read_problem(options.problem)
    simulator, rng = Simulator(problem.mesh), np.random.default_rng([options.seed, 25])
    sampler = EventSampler(problem.mesh, EventSettings(body_force_share=0.0))
    events = [sampler.draw(rng) for _ in range(options.members)]
    young, size = rng.uniform(10.0, 60.0, options.members), rng.uniform(2.0, 25.0, options.members)
    _, unit = linear_answers(simulator, events, tr.Material(10.0, 0.45))
    scales = unit * size * young / 10.0
    forces = np.stack([simulator.forces(e.load(simulator, s)) for e, s in zip(events, scales, strict=True)])
    poisson = np.full(options.members, 0.45)
    spent, found = seconds_of(lambda: simulator.body.solve_many(young, poisson, forces=forces, tolerance=options.tol))
    lost = {index for index, _ in found.failed}
    reports = [report for index, report in enumerate(found.reports) if index not in lost]
    largest = np.linalg.norm(found.displacement, axis=2).max(axis=1)[[i not in lost for i in range(options.members)]]
    names = ("iterations", "solves", "factorisations", "load_steps")
    return {
        "n_nodes": problem.mesh.n_nodes,
        "members": options.members,
        "seed": options.seed,
        "seconds": spent,
        "ms_a_member": 1e3 * spent / options.members,
        "failed": len(lost),
        "failures": [list(pair) for pair in found.failed[:10]],
        "counters_a_member": {name: float(np.mean([report[name] for report in reports])) for name in names},
        "largest_mm": dict(zip(("0", "25", "50", "75", "100"), np.percentile(largest, range(0, 101, 25)), strict=True)),
        "peak_mib": process_peak_mib(),
    }


def reference(options: argparse.Namespace) -> dict:
    """Write the problem, its load scaled, with the answer of full Newton at a residual of 1e-11 as reference."""
    with np.load(options.problem) as given:
        arrays = dict(given)
    arrays["forces_mN"] = options.scale * arrays["forces_mN"]
    body = _core.Body(
        arrays["nodes_mm"],
        arrays["tets"].astype(np.int64),
        np.sort(arrays["fixed_nodes"]).astype(np.int64),
        element=options.element,
    )
    padded = np.zeros((body.n_nodes, 3))
    padded[: len(arrays["forces_mN"])] = arrays["forces_mN"]
    moduli = np.atleast_1d(arrays["young_kPa"]), np.atleast_1d(arrays["poisson"])
    found = body.solve(*moduli, forces=padded, method="newton", tolerance=1e-11)
    arrays["displacement_mm"] = found.displacement[: len(arrays["nodes_mm"])]
    np.savez(options.out, **arrays)
    return {"residual": found.report["residual"], "factorisations": found.report["factorisations"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", choices=["floor", "solve", "many", "reference"])
    parser.add_argument("problem", nargs="?", type=Path)
    parser.add_argument("out", nargs="?", type=Path)
    parser.add_argument("--element", default="tet4", choices=["tet4", "tet10"])
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--members", type=int, default=200)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tol", type=float, default=1e-6)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    print(json.dumps({"floor": floor, "solve": solve, "many": many, "reference": reference}[options.work](options)))


if __name__ == "__main__":
    main()
