"""The solver compared with the machine's limits and other programs, in one run -> `archive/solver`.

    python -m speed.solver [--quick] [--out FOLDER] [--reference DIR] [--peers PYTHON]
    python -m speed.solver --again many dome_4k_pull_x2   (measures these again, and keeps all else in the archive)
    python -m speed.solver --table     (only writes the tables of RESULTS.md from the archive)

Every measurement is a process of its own (`solver_work.py`, `peers/with_*.py`); its command is stored with its figures.
"""

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from common import REPOSITORY, read_archive, write_archive
from readme import write_table
from speed.half_ellipsoid import SEED, write_size
from speed.solver_table import tables

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive" / "solver", HERE / "RESULTS.md"
TABLES = ("solves/#", "sizes/rows/#", "peers/#", "peers_elsewhere/#")
SCRATCH = Path("build/bench-solver")
#: GFLOP of one Cholesky of the 4k and 20k problems' stiffness with a METIS ordering.
FLOOR_GFLOP = {"dome_4k": 1.2, "dome_20k": 38.0}
DOMES = ("dome_4k_pull", "dome_4k_push", "dome_4k_pull_nu049", "dome_20k_pull")
SIZES = {"1k": 1_000, "4k": 4_000, "10k": 10_000, "20k": 20_000, "50k": 50_000, "100k": 100_000}
#: A peer's ten-node run is ended after this.
QUADRATIC_LIMIT_S = 300.0
#: Measured once on another machine of two cores (the README of the reference problems), seconds by threads.
STORED = [
    ("FEBio 4.11", "BFGS, whole process", "dome_4k_pull", {"1": 0.79, "2": 0.47}),
    ("FEBio 4.11", "BFGS, whole process", "dome_20k_pull", {"1": 9.0, "2": 4.8}),
    ("FEBio 4.11", "full Newton, whole process", "dome_4k_pull", {"1": 1.06, "2": 0.69}),
    ("FEBio 4.11", "full Newton, whole process", "dome_20k_pull", {"1": 14.9, "2": 8.75}),
    ("dolfinx 0.5", "Newton, MUMPS Cholesky", "dome_4k_pull", {"1": 0.97}),
    ("dolfinx 0.5", "Newton, MUMPS Cholesky", "dome_20k_pull", {"1": 15.1}),
]


def measure(python: str, threads: int, *words: object, limit_s: float = 3600.0) -> dict:
    """Return a process's last line as JSON with its command; for a failure, the reason is in `error`."""
    pools = ("RAYON", "OMP", "MKL", "OPENBLAS")
    environment = {**os.environ, **{f"{pool}_NUM_THREADS": str(threads) for pool in pools}}
    arguments = [str(word) for word in words]
    name = "python" if python == sys.executable else os.path.relpath(python, REPOSITORY)
    command = shlex.join([f"RAYON_NUM_THREADS={threads}", name, *arguments])
    print(command, flush=True)
    try:
        done = subprocess.run(
            [python, *arguments],
            cwd=REPOSITORY,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=limit_s,
        )
    except subprocess.TimeoutExpired:
        return {"command": command, "threads": threads, "error": f"took longer than {limit_s:.0f} s"}
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        why = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
        print(f"  failed: {why[0]}", flush=True)
        return {"command": command, "threads": threads, "error": why[0][:300]}
    return {"command": command, "threads": threads, **json.loads(lines[-1])}


def work(threads: int, *words: object) -> dict:
    """Return one measurement of ours."""
    return measure(sys.executable, threads, "benchmarks/speed/solver_work.py", *words)


def best_of(first: dict, second: dict) -> dict:
    """Return the better rates of two measurements, before and after everything else."""
    rates = [name for name, value in first.items() if isinstance(value, dict) and name.endswith(("gflops", "per_s"))]
    return {**first, **{name: {n: max(v, second[name][n]) for n, v in first[name].items()} for name in rates}}


def problems(folder: Path) -> dict[str, Path]:
    """Return the problem files by name; the pull at twice its load gets our own tight Newton answer as reference."""
    found = {name: folder / f"{name}.npz" for name in DOMES}
    found["dome_4k_pull_x2"] = SCRATCH / "dome_4k_pull_x2.npz"
    made = work(2, "reference", found["dome_4k_pull"], found["dome_4k_pull_x2"], "--scale", 2)
    if "error" in made:
        raise SystemExit(made["error"])
    return found


def solves(files: dict[str, Path], repeats: int) -> list[dict]:
    rows = []
    for name, path in files.items():
        counted = max(3, repeats // 2) if "20k" in name and repeats > 2 else repeats
        rows += [{"name": name, **work(n, "solve", path, "--repeats", counted)} for n in (1, 2)]
    return rows


def with_floors(rows: list[dict], floor: dict) -> None:
    """Add to each row its floor (one Cholesky at this machine's dgemm rate on as many threads) and its ratios."""
    for row in rows:
        flops = next((gflop for name, gflop in FLOOR_GFLOP.items() if row["name"].startswith(name)), None)
        if flops is None or "error" in row:
            continue
        row["floor_s"] = flops / floor["dgemm_gflops"][str(row["threads"])]
        row["floors"] = {kind: row[f"{kind}_s"]["median"] / row["floor_s"] for kind in ("cold", "warm")}


def size_study(names: list[str], repeats: int) -> dict:
    """Return cold times by size and the growth exponents of time and memory by least squares in logarithms."""
    rows = []
    for name in names:
        path = SCRATCH / f"half_ellipsoid_{name}.npz"
        write_size(REPOSITORY / path, SIZES[name])
        rows.append({"name": name, **work(2, "solve", path, "--repeats", repeats if SIZES[name] < 50_000 else 1)})
    good = [row for row in rows if "error" not in row]
    nodes = np.log([row["n_nodes"] for row in good])
    kept = {
        "time": [row["cold_s"]["median"] for row in good],
        "memory": [row["peak_mib"] - row["peak_before_mib"] for row in good],
    }
    growth = (
        {kind: float(np.polyfit(nodes, np.log(values), 1)[0]) for kind, values in kept.items()} if len(good) > 1 else {}
    )
    return {"seed": SEED, "rows": rows, "growth_exponent": growth}


def peers(python: Path, files: dict[str, Path], quadratic: Path, quick: bool) -> tuple[list[dict], list[dict]]:
    """Return rows of the peers that are installed, and the names of those that are not."""
    rows, skipped = [], []
    repeats = 1 if quick else 3
    chosen = ["dome_4k_pull"] if quick else list(files)
    if not python.exists():
        skipped += [
            {"name": name, "reason": f"no {python}: make -C benchmarks/speed peers"}
            for name in ("felupe", "scikit-fem")
        ]
    runs = (
        [("felupe", "with_felupe.py", "newton"), ("scikit-fem", "with_skfem.py", "newton")] if python.exists() else []
    )
    outside = (("CalculiX", "ccx", "calculix", ("newton",)), ("FEBio", "febio4", "febio", ("bfgs", "newton")))
    for name, program, script, methods in outside:
        if shutil.which(program):
            runs += [(name, f"with_{script}.py", method) for method in methods]
        else:
            skipped.append({"name": name, "reason": f"`{program}` is not on the path"})
    interpreter = str(python.absolute()) if python.exists() else sys.executable
    for name, script, method in runs:
        call = (f"benchmarks/speed/peers/{script}", "--method", method, "--repeats")
        for problem in chosen:
            for threads in (2,) if quick else (1, 2):
                arguments = (
                    call[0],
                    files[problem],
                    *call[1:],
                    1 if "20k" in problem else repeats,
                    "--threads",
                    threads,
                )
                rows.append(
                    {"name": name, "problem": problem, "element": "tet4", **measure(interpreter, threads, *arguments)}
                )
        if script in ("with_felupe.py", "with_skfem.py") and not quick:
            arguments = (call[0], quadratic, *call[1:], 1, "--threads", 2, "--element", "tet10")
            measured = measure(interpreter, 2, *arguments, limit_s=QUADRATIC_LIMIT_S)
            rows.append({"name": name, "problem": quadratic.stem, "element": "tet10", **measured})
    return rows, skipped


def again(answer: dict, reference: Path, names: list[str], repeats: int, members: int) -> dict:
    """Return the answer with many solves, or problems by name, measured again between two measurements of the floor."""
    before = work(2, "floor")
    made = {}
    if "many" in names:
        made["many"] = work(2, "many", reference / "dome_4k_pull.npz", "--members", members)
    files = {name: path for name, path in problems(reference).items() if name in names}
    rows = solves(files, repeats)
    floor = best_of(before, work(2, "floor"))
    with_floors(rows, floor)
    rates = {name: floor[name] for name in ("dgemm_gflops", "sgemm_gflops", "triad_gb_per_s")}
    when = datetime.now(UTC).isoformat(timespec="seconds")
    stamp = {"date": when, "commit": commit(), "floor": rates}
    new = {(row["name"], row["threads"]): {**row, **stamp} for row in rows}
    kept = [new.get((row["name"], row["threads"]), row) for row in answer["solves"]]
    return {**answer, **{name: {**row, **stamp} for name, row in made.items()}, "solves": kept}


def commit() -> str:
    """Return the commit, with a mark where files differ from it."""
    output = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12"], cwd=REPOSITORY, capture_output=True, text=True
    )
    return output.stdout.strip() or "unknown"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ARCHIVE)
    parser.add_argument("--reference", type=Path, default=Path("../shared/reference"))
    parser.add_argument("--peers", type=Path, default=Path(".venv-peers/bin/python"))
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="few repeats, small sizes, one problem a peer")
    parser.add_argument("--again", nargs="+", metavar="NAME", help="measure `many` or problems again, keep all else")
    parser.add_argument("--table", action="store_true", help="write the tables from the archive, measure nothing")
    options = parser.parse_args()
    out = options.out.absolute()
    if options.again:
        os.chdir(REPOSITORY)
        SCRATCH.mkdir(parents=True, exist_ok=True)
        answer = read_archive(out)
        members = 16 if options.quick else 200
        answer = again(answer, options.reference, options.again, options.repeats, members)
        write_archive(out, answer, TABLES)
    elif not options.table:
        os.chdir(REPOSITORY)
        SCRATCH.mkdir(parents=True, exist_ok=True)
        quick = options.quick
        repeats, smoke = (2, ["--quick"]) if quick else (options.repeats, [])
        before = work(2, "floor", *smoke)
        about = {"machine": before.pop("machine"), "versions": before.pop("versions")}
        files = problems(options.reference)
        if quick:
            del files["dome_20k_pull"]
        rows = solves(files, repeats)
        many = work(2, "many", files["dome_4k_pull"], "--members", 16 if quick else 200)
        sizes = size_study(["1k", "4k"] if quick else list(SIZES), min(repeats, 5))
        quadratic = SCRATCH / "dome_4k_pull_tet10.npz"
        work(2, "reference", files["dome_4k_pull"], quadratic, "--element", "tet10")
        ten = {
            "name": "dome_4k_pull, ten-node",
            **work(2, "solve", quadratic, "--element", "tet10", "--repeats", 1 if quick else 3),
        }
        others, skipped = peers(options.peers, files, quadratic, quick)
        floor = best_of(before, work(2, "floor", *smoke))
        with_floors(rows, floor)
        answer = {
            "schema": "tissuereg.bench-solver/1",
            "command": shlex.join(["python", "-m", "speed.solver", *sys.argv[1:]]),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit(),
            "quick": quick,
            **about,
            "tolerance": 1e-6,
            "floor": {**floor, "gflop": FLOOR_GFLOP},
            "solves": rows,
            "many": many,
            "sizes": sizes,
            "tet10": ten,
            "peers": others,
            "peers_skipped": skipped,
            "peers_elsewhere": [
                dict(zip(("name", "settings", "problem", "cold_s"), row, strict=True)) for row in STORED
            ],
        }
        write_archive(out, answer, TABLES)
    if out == ARCHIVE:
        write_table("solver", tables(read_archive(out)), PAGE)


if __name__ == "__main__":
    main()
