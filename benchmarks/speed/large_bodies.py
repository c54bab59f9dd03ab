"""Commands on bodies of up to 200,000 nodes: time, peak memory -> archive, RESULTS-large-bodies.md.

    python -m speed.large_bodies [--sizes N ...] [--threads N] [--out FILE] [--estimate] [--page]

A half ellipsoid pulled on one patch. Its markers are those of one mesh of 20,000 nodes, so that every mesh is
registered to the same data. Each command runs in a process of its own. `--estimate` estimates anew what has been
measured, `--page` writes the page from the archive.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import commit, read_archive, write_archive
from speed.half_ellipsoid import write_size
from tissuereg._base.machine import machine, versions
from tissuereg.io.tables import write_markers, write_points

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive" / "large-bodies", HERE / "RESULTS-large-bodies.md"
TABLES = ("rows/#",)
SCHEMA = "tissuereg.large-bodies/1"

SIZES = (4_000, 20_000, 100_000, 200_000)
N_TRUTH, N_MARKERS, STD_MM, SEED = 20_000, 15, 0.1, 0
TARGET_MM = (20.0, 5.0, 25.0)


def write_data(folder: Path) -> None:
    """Write markers and a target of the solved body of `N_TRUTH` nodes."""
    write_size(folder / "truth.npz", N_TRUTH)
    with np.load(folder / "truth.npz") as arrays:
        mesh = tr.Mesh(arrays["nodes_mm"], arrays["tets"], {"fixed": arrays["fixed_nodes"]})
        load, material = tr.Load(forces=arrays["forces_mN"]), tr.Material(10.0, 0.45)
    moved = tr.Simulator(mesh).solve(load, material).displacement
    rng = np.random.default_rng(SEED)
    nodes = rng.choice(np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes), N_MARKERS, replace=False)
    seen = mesh.nodes[nodes] + moved[nodes] + STD_MM * rng.standard_normal((N_MARKERS, 3))
    write_markers(folder / "markers.csv", tr.Markers(mesh.nodes[nodes], seen, STD_MM))
    write_points(folder / "targets.csv", {"lesion": TARGET_MM})


def expected(problem: Path, threads: int) -> dict:
    """Return what is estimated of both commands; run in a process of its own."""
    from tissuereg.io.problems import read_problem
    from tissuereg.registration.contacts.size import expected_work
    from tissuereg.simulation.size import SOLVE, BodySize, Estimate

    simulator = tr.Simulator(read_problem(problem).mesh)
    size = BodySize.of(simulator)
    works = {"register": expected_work(3 * N_MARKERS, 3, 64, matched=False), "solve": SOLVE}
    told = {name: Estimate.of(size, work, threads) for name, work in works.items()}
    return {
        "size": {name: getattr(size, name) for name in ("n_nodes", "n_tets", "n_unknowns", "n_entries", "flops")},
        "analyse_s": simulator.body.analyse_seconds,
        "expected": {
            name: {"seconds": one.seconds, "peak_bytes": one.peak_bytes, "available_bytes": one.available_bytes}
            for name, one in told.items()
        },
    }


def run(words: list[str], threads: int) -> dict:
    """Return wall and CPU seconds, peak memory and the JSON of a command of its own process."""
    with tempfile.TemporaryDirectory() as name:
        told = Path(name) / "told.json"
        whole = [sys.executable, "-m", "tissuereg", *words, "--threads", str(threads), "--json", str(told), "--quiet"]
        start = time.perf_counter()
        process = subprocess.Popen(whole, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"})
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        if os.waitstatus_to_exitcode(status) not in (0, 4):
            message = f"{' '.join(whole)} ended with {status}"
            raise RuntimeError(message)
        answer = json.loads(told.read_text(encoding="utf-8"))
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "wall_s": wall,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_bytes": unit * used.ru_maxrss,
        "seconds": answer["seconds"],
        "work": answer.get("work") or {name: answer[name] for name in ("factorisations", "solves", "iterations")},
    }


def in_a_process(*words: str) -> str:
    """Return what this script prints: whatever it holds would count for the commands that it starts."""
    return subprocess.run(
        [sys.executable, "-m", "speed.large_bodies", *words], stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def estimated(problem: Path, n_nodes: int, threads: int) -> dict:
    """Write the problem of a size, and return what is estimated of it."""
    in_a_process("--make", str(problem), "--sizes", str(n_nodes))
    return json.loads(in_a_process("--expected", str(problem), "--threads", str(threads)))


def measured(n_nodes: int, data: Path, threads: int) -> dict:
    """Return what both commands take on a body of about so many nodes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        problem = folder / "problem.npz"
        found = estimated(problem, n_nodes, threads)
        files = [str(problem), str(data / "markers.csv"), "--targets", str(data / "targets.csv")]
        commands = {
            "solve": ["solve", str(problem), "--tol", "1e-6", "--out", str(folder / "solved.npz")],
            "register": ["register", *files, "--out", str(folder / "registered")],
        }
        return {**found, "measured": {name: run(words, threads) for name, words in commands.items()}}


def page(answer: dict) -> str:
    """Return the page of an archive."""
    used = ", ".join(f"{name} {number}" for name, number in answer["versions"].items())
    rows = answer["rows"]
    return "\n".join(
        [
            TEXT,
            f"`{answer['command']}`, {answer['date']}, commit {answer['commit']}"
            f"{' with changed files' if answer['changed_files'] else ''}, {answer['machine']['processor']}, "
            f"{answer['machine']['cores']} cores, {answer['threads']} threads; {used}. {SHARED}",
            "",
            "| nodes | tets | unknowns | entries of a factor, millions | a factorisation, GFlop | analysis, s |",
            "| --- | --- | --- | --- | --- | --- |",
            *(_size_row(row) for row in rows),
            "",
            *_table("register", "`tissuereg register`, 15 markers, one target, all files written", rows),
            "",
            *_table("solve", "`tissuereg solve --tol 1e-6`, the pull itself", rows),
            "",
        ]
    )


def _size_row(row: dict) -> str:
    size = row["size"]
    numbers = [f"{size[name]:,}" for name in ("n_nodes", "n_tets", "n_unknowns")]
    numbers += [f"{size['n_entries'] / 1e6:,.1f}", f"{size['flops'] / 1e9:,.1f}", f"{row['analyse_s']:.2f}"]
    return f"| {' | '.join(numbers)} |"


def _table(command: str, title: str, rows: list[dict]) -> list[str]:
    lines = [
        f"{title}:",
        "",
        "| nodes | wall, s | CPU, s | estimated, s | peak memory, GB | estimated, GB | factorisations | stages, s |",
        "| --- " * 8 + "|",
    ]
    for row in rows:
        found, told = row["measured"][command], row["expected"][command]
        stages = sorted(((value, name) for name, value in found["seconds"].items() if name != "total"), reverse=True)
        shown = ", ".join(f"{name} {value:.1f}" for value, name in stages[:4])
        cells = [
            f"{row['size']['n_nodes']:,}",
            f"{found['wall_s']:.1f}",
            f"{found['cpu_s']:.1f}",
            f"{told['seconds']:.1f}",
            f"{found['peak_bytes'] / 1e9:.2f}",
            f"{told['peak_bytes'] / 1e9:.2f}",
            str(found["work"]["factorisations"]),
            shown,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


SHARED = (
    "The machine is shared with other work: wall times are upper bounds, CPU times (all threads together) are "
    "affected little; estimated times come from the speed that the machine had at that moment."
)

TEXT = """# Bodies of up to 200,000 nodes

Written by `make -C benchmarks/speed large-bodies` from `archive/large-bodies`; edit neither. What is said and refused
before anything is factored: `docs/large-bodies.md`.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ARCHIVE)
    parser.add_argument("--estimate", action="store_true", help="estimate anew what has been measured")
    parser.add_argument("--page", action="store_true", help="write the page from the archive, measure nothing")
    for name in ("--data", "--make", "--expected"):
        parser.add_argument(name, type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.data:
        write_data(options.data)
        return 0
    if options.make:
        write_size(options.make, options.sizes[0])
        return 0
    if options.expected:
        print(json.dumps(expected(options.expected, options.threads)))
        return 0
    if options.estimate:
        answer = read_archive(options.out)
        with tempfile.TemporaryDirectory() as name:
            for row in answer["rows"]:
                row |= estimated(Path(name) / "problem.npz", row["size"]["n_nodes"], answer["threads"])
        write_archive(options.out, answer, TABLES)
    elif not options.page:
        rows = []
        with tempfile.TemporaryDirectory() as name:
            in_a_process("--data", name)
            for n_nodes in options.sizes:
                rows.append(measured(n_nodes, Path(name), options.threads))
                print(json.dumps(rows[-1]), file=sys.stderr)
        answer = {
            "schema": SCHEMA,
            "command": "python -m speed.large_bodies",
            "date": datetime.now(UTC).date().isoformat(),
            **commit(),
            "machine": machine(),
            "versions": versions(),
            "threads": options.threads,
            "rows": rows,
        }
        write_archive(options.out, answer, TABLES)
    if options.out == ARCHIVE:
        PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
