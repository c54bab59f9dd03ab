"""Whole `register` calls with nothing known of the load, timed -> archive/time, RESULTS.md.

    python -m loadfree.timing [--repeats N] [--threads N] [--cases ...] [--out FILE] [--page]

A process a measurement; repeats differ by the markers' noise, and on the dome by the event: one of every kind in turn.
`--page` writes the page again from the archive.
"""

import argparse
import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import commit, write_archive
from loadfree import table
from loadfree.archive import SCRATCH
from loadfree.times import ARCHIVE, SCHEMA, TABLES
from speed.half_ellipsoid import SEED, write_size
from tissuereg._base.machine import machine

WORK = "loadfree.timing_work"

CASES = ("dome", "large", "points")
N_LARGE = 20_000


def large_problem() -> Path:
    """Write a half ellipsoid of 20,000 nodes and its pull on one patch, as our own solver has it; return the file."""
    path = SCRATCH / f"half_ellipsoid_{N_LARGE}_{SEED}.npz"
    if not path.exists():
        SCRATCH.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".part.npz")
        write_size(partial, N_LARGE)
        with np.load(partial) as given:
            arrays = dict(given)
        mesh = tr.Mesh(arrays["nodes_mm"], arrays["tets"], {"fixed": arrays["fixed_nodes"]})
        material = tr.Material(float(arrays["young_kPa"]), float(arrays["poisson"]))
        found = tr.Simulator(mesh).solve(tr.Load(forces=arrays["forces_mN"]), material)
        np.savez(partial, displacement_mm=found.displacement, **arrays)
        partial.rename(path)
    return path


def measured(case: str, seed: int, threads: int) -> dict:
    """Return what a fresh process measures."""
    words = [sys.executable, "-m", WORK, case, str(seed), "--threads", str(threads)]
    if case == "large":
        words += ["--problem", str(large_problem())]
    done = subprocess.run(words, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--out", type=Path, default=ARCHIVE)
    parser.add_argument("--page", action="store_true", help="write the page from the archive, time nothing")
    options = parser.parse_args()
    if not options.page:
        runs = {case: [_told(case, seed, options.threads) for seed in range(options.repeats)] for case in options.cases}
        answer = {
            "schema": SCHEMA,
            "command": "python -m loadfree.timing",
            "date": datetime.now(UTC).date().isoformat(),
            **commit(),
            "machine": machine(),
            "versions": runs[options.cases[0]][0]["versions"],
            "threads": options.threads,
            "runs": runs,
        }
        write_archive(options.out, answer, TABLES)
    table.write()
    return 0


def _told(case: str, seed: int, threads: int) -> dict:
    run = measured(case, seed, threads)
    for call in run["calls"]:
        print(f"{case} {seed} {call['call']}: {call['wall_s']:.2f} s, off {call['body_mm']:.3f} mm", flush=True)
    return run


if __name__ == "__main__":
    sys.exit(main())
