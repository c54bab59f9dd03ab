"""What all peers share: the problem, repeats in one process, and the JSON that `solver.py` reads."""

import argparse
import json
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Found:
    """What one cold run found."""

    displacement: np.ndarray  # mm, of the mesh's corner nodes
    iterations: int | None = None
    factorisations: int | None = None
    residual: float | None = None  # over the load, free degrees of freedom
    seconds: float | None = None  # where the run times itself
    load_steps: int = 1


def run(
    name: str, cold: Callable[[dict, argparse.Namespace], Found], about: Callable[[argparse.Namespace], dict]
) -> None:
    """Solve the problem of the command line several times and print one JSON object.

    Cold runs are timed from arrays in memory to displacement, unless the run times itself. `about` tells version,
    settings and law differences.
    """
    parser = argparse.ArgumentParser(description=f"cold solves with {name}")
    parser.add_argument("problem", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--tolerance", type=float, default=1e-6)
    parser.add_argument("--element", default="tet4", choices=["tet4", "tet10"])
    parser.add_argument("--method", default="newton", choices=["newton", "bfgs"])
    options = parser.parse_args()
    with np.load(options.problem) as given:
        problem = dict(given)
    seconds = []
    for _ in range(options.repeats):
        start = time.perf_counter()
        found = cold(problem, options)
        seconds.append(found.seconds or time.perf_counter() - start)
    off = None
    if "displacement_mm" in problem:
        off = float(np.linalg.norm(found.displacement - problem["displacement_mm"], axis=1).max())
    summary = {
        **about(options),
        "cold_s": {"minimum": min(seconds), "median": float(np.median(seconds)), "repeats": len(seconds)},
        "counters": {
            "iterations": found.iterations,
            "factorisations": found.factorisations,
            "residual": found.residual,
            "load_steps": found.load_steps,
        },
        "difference_mm": off,
        "peak_mib": peak_mib(),
    }
    print(json.dumps(summary))


def peak_mib() -> float:
    """Return the peak memory of this process or, if larger, of the programs that it ran, in MiB (Linux)."""
    own = int(Path("/proc/self/status").read_text(encoding="utf-8").split("VmHWM:")[1].split()[0])
    return max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1024


def lame(problem: dict) -> tuple[float, float]:
    """Return shear modulus and first Lame constant in kPa."""
    young, poisson = float(problem["young_kPa"]), float(problem["poisson"])
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


class Pardiso:
    """Cholesky of the upper triangle by MKL Pardiso; its LU where the matrix is not positive definite."""

    def __init__(self) -> None:
        self.factorisations = 0

    def __call__(self, matrix, right):
        """Return the solution of one sparse symmetric system."""
        from pypardiso import PyPardisoSolver
        from pypardiso.pardiso_wrapper import PyPardisoError
        from scipy.sparse import csr_matrix, triu

        for kind, part in ((2, triu(matrix, format="csr")), (11, csr_matrix(matrix))):
            solver = PyPardisoSolver(mtype=kind)
            self.factorisations += 1
            try:
                return solver.solve(part, np.asarray(right))
            except PyPardisoError:
                if kind == 11:
                    raise
            finally:
                solver.free_memory(everything=True)
        raise AssertionError
