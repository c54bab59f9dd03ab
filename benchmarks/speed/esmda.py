"""One ES-MDA update beside the peers, in one run: writes ``archive/esmda``.

    python -m speed.esmda [--out FOLDER] [--quick] [--cases surgical wide large]

Every program gets the same predictions, observations, standard deviations, inflation coefficient and standard normal
draws, and must return the same ensemble. Times are of one update in a warm process; the programs take turns of five
updates, so that a busy moment of the machine meets all of them. Memory is measured in a process of its own for each
program: the peak of the resident memory during the update, less what was resident before it.
"""

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive" / "esmda", HERE / "RESULTS.md", ("cases/#/rows/#",)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
#: Variables that hold OpenBLAS to kernels of an older processor, which would slow numpy and with it the peers.
KERNELS = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")
#: Parameters, observations, members; turns; turns with --quick.
CASES = {
    "surgical": ((26, 45, 100), 600, 10),
    "wide": ((26, 300, 1000), 10, 1),
    "large": ((100_000, 10_000, 100), 2, 1),
}
ALPHA = 5.0
#: Updates in a row, as many as a usual schedule has; the first of them finds caches full of what others left.
TURN = 5
#: Largest difference from our answer, in standard deviations of the prior. One peer's explicit inverse loses eight
#: digits at the large size.
AGREEMENT = 1e-6


class Problem:
    """Arrays of one case; a linear model, as a peer's own tests have it."""

    def __init__(self, sizes: tuple[int, int, int]) -> None:
        import numpy as np

        n_parameters, n_obs, n_members = sizes
        rng = np.random.default_rng(7)
        self.parameters = rng.standard_normal((n_parameters, n_members))
        model = rng.standard_normal((n_obs, min(n_parameters, 26)))
        self.predicted = model @ self.parameters[: model.shape[1]]
        self.observed = rng.standard_normal(n_obs)
        self.std = np.full(n_obs, 0.5)
        self.draws = rng.standard_normal((n_obs, n_members))


def with_tissuereg(p: Problem, threads: int) -> Callable[[], object]:
    """Return the update by tissuereg: the noise is made anew every time, as it would be in a first update."""
    from tissuereg import _core

    def update() -> object:
        noise = _core.Noise.diagonal(p.std)
        return _core.Step(p.predicted, p.observed, noise, p.draws, alpha=ALPHA, threads=threads).apply(p.parameters)

    return update


def with_numpy(p: Problem, threads: int) -> Callable[[], object]:
    """Return the textbook's update in plain numpy, solved on the smaller side."""
    import numpy as np

    def update() -> object:
        n_obs, n_members = p.predicted.shape
        scale = 1 / np.sqrt((n_members - 1) * ALPHA)
        s = (p.predicted - p.predicted.mean(axis=1, keepdims=True)) * (scale / p.std)[:, None]
        r = (p.observed[:, None] - p.predicted) * (scale / p.std)[:, None] + p.draws / np.sqrt(n_members - 1)
        if n_obs <= n_members:
            weights = s.T @ np.linalg.solve(s @ s.T + np.eye(n_obs), r)
        else:
            weights = np.linalg.solve(s.T @ s + np.eye(n_members), s.T @ r)
        return p.parameters + (p.parameters - p.parameters.mean(axis=1, keepdims=True)) @ weights

    return update


def with_ies(p: Problem, threads: int) -> Callable[[], object]:
    """Return the update by iterative_ensemble_smoother, without truncation."""
    from iterative_ensemble_smoother import ESMDA

    perturbations = p.draws * p.std[:, None]

    def update() -> object:
        import numpy as np

        smoother = ESMDA(p.std**2, p.observed, alpha=np.array([ALPHA]), seed=1)
        smoother.alpha = np.array([ALPHA])  # the constructor rescales coefficients whose inverses do not add up to one
        smoother.prepare_assimilation(Y=p.predicted, truncation=1.0, observation_perturbations=perturbations)
        return smoother.assimilate_batch(X=p.parameters)

    return update


def with_pyesmda(kind: str) -> Callable[[Problem, int], Callable[[], object]]:
    """Return the update by pyesmda with one of its inversions."""

    def make(p: Problem, threads: int) -> Callable[[], object]:
        import covmats
        import numpy as np
        from pyesmda._inversion import ESMDAInversionType, inversion

        def update() -> object:
            noise = covmats.CovViaDiagonal(p.std**2)
            perturbed = p.observed[:, None] + np.sqrt(ALPHA) * p.std[:, None] * p.draws
            change = inversion(
                ESMDAInversionType(kind), ALPHA, noise, perturbed, p.predicted, p.parameters, truncation=1.0
            )
            return p.parameters + change

        return update

    return make


def with_dageo(p: Problem, threads: int) -> Callable[[], object]:
    """Return the update by dageo, its generator replaced by one that returns our draws."""
    import dageo
    import numpy as np

    class Given(np.random.Generator):
        def normal(self, *args: object, **kwargs: object) -> object:
            return p.draws.T

    prior, predicted = np.ascontiguousarray(p.parameters.T), np.ascontiguousarray(p.predicted.T)
    generator = Given(np.random.PCG64(1))

    def update() -> object:
        with contextlib.redirect_stdout(io.StringIO()):
            found = dageo.esmda(
                prior,
                None,
                p.observed,
                p.std,
                alphas=np.array([ALPHA]),
                data_prior=predicted,
                return_post_data=False,
                random=generator,
            )
        return found.T

    return update


#: Program and form; which of them the large case leaves out, as they form matrices of observations by observations.
PROGRAMS: dict[str, tuple[Callable[[Problem, int], Callable[[], object]], bool]] = {
    "tissuereg": (with_tissuereg, True),
    "numpy": (with_numpy, True),
    "iterative_ensemble_smoother": (with_ies, True),
    "pyesmda, Cholesky": (with_pyesmda("cholesky"), False),
    "pyesmda, Woodbury": (with_pyesmda("woodbury"), True),
    "dageo": (with_dageo, False),
}


def times(case: str, threads: int, quick: bool) -> dict[str, object]:
    """Time all programs of a case in turns, in this process."""
    import numpy as np

    sizes, repeats, few = CASES[case]
    problem, repeats = Problem(sizes), few if quick else repeats
    updates, rows, reference = {}, [], None
    for name, (make, large_too) in PROGRAMS.items():
        if case == "large" and not large_too:
            continue
        updates[name] = make(problem, threads)
        found = np.asarray(updates[name]())
        reference = found if reference is None else reference
        off = float(np.abs(found - reference).max())
        if off > AGREEMENT:
            message = f"{name} must agree with tissuereg to {AGREEMENT:g}, it is off by {off:g}"
            raise SystemExit(message)
        rows.append({"program": name, "off": off})
    taken: dict[str, list[float]] = {name: [] for name in updates}
    for _ in range(repeats):
        for name, update in updates.items():
            for _ in range(TURN):
                start = time.perf_counter()
                update()
                taken[name].append(time.perf_counter() - start)
    for row in rows:
        seconds = np.array(taken[row["program"]])
        row |= {"minimum_s": seconds.min(), "median_s": np.median(seconds), "p99_s": np.percentile(seconds, 99)}
        row["first_s"] = np.median(seconds[::TURN])
        row |= {key: float(value) for key, value in row.items() if key.endswith("_s")}
    return {"case": case, "sizes": sizes, "threads": threads, "turns": repeats, "rows": rows}


def extra_memory(case: str, program: str, threads: int) -> float:
    """Return the MB that one update needs beyond its arguments, its result included; run in a process of its own."""
    update = PROGRAMS[program][0](Problem(CASES[case][0]), threads)
    small = PROGRAMS[program][0](Problem(CASES["surgical"][0]), threads)
    small()  # imports and pools are not the update's
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak starts again from what is resident now
    before = resident("VmRSS")
    update()
    return (resident("VmHWM") - before) * 1024 / 1e6


def resident(field: str) -> int:
    """Return a line of ``/proc/self/status`` in KiB."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field + ":"))


def child(threads: int, *words: str) -> object:
    """Run this file in a process whose BLAS has `threads` threads and the machine's own kernels; return its JSON."""
    environment = {key: value for key, value in os.environ.items() if key not in KERNELS}
    environment |= dict.fromkeys(THREADS, str(threads))
    command = [sys.executable, __file__, "--threads", str(threads), *words]
    return json.loads(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)


def table(answer: dict) -> str:
    """Return the page's tables, and what the ratios to the fastest other programs are."""
    machine, found = answer["machine"], answer["versions"]
    versions = ", ".join(f"{name} {version}" for name, version in found.items() if name != "python")
    quick = "; **a smoke run, figures mean nothing**" if answer["quick"] else ""
    lines = [
        f"`{answer['command']}`, {answer['date']}, "
        f"{machine['processor']}, {machine['cores']} cores; {versions}{quick}.",
        "",
        "| parameters, observations, members; threads | program "
        "| minimum, ms | median | 99 % | first | off | extra MB |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    ratios = []
    for case in answer["cases"]:
        label = ", ".join(f"{n:,}" for n in case["sizes"]) + f"; {case['threads']}"
        for row in case["rows"]:
            ms = " | ".join(f"{1e3 * row[key]:.3g}" for key in ("minimum_s", "median_s", "p99_s", "first_s"))
            memory = f"{row['extra_mb']:.0f}" if "extra_mb" in row else ""
            lines.append(f"| {label} | {row['program']} | {ms} | {row['off']:.0e} | {memory} |")
        ours, numpy, *peers = case["rows"]
        fastest = min(peers, key=lambda row: row["median_s"])
        against = [
            f"{ours['median_s'] / row['median_s']:.2f} ({ours['p99_s'] / row['p99_s']:.2f}) of {row['program']}"
            for row in (fastest, numpy)
        ]
        ratios.append(f"* {label}: {', '.join(against)}")
    return "\n".join([*lines, "", *ratios, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="of a part or a smoke run: none by default; of the whole: the archive")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--quick", action="store_true", help="few repeats")
    parser.add_argument("--threads", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--memory", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--times", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory:
        json.dump(extra_memory(*options.memory, options.threads), sys.stdout)
        return
    if options.times:
        json.dump(times(options.times, options.threads, options.quick), sys.stdout)
        return
    from tissuereg._base.machine import machine

    whole = not options.quick and options.cases == list(CASES)
    out = options.out or (ARCHIVE if whole else None)
    cases = []
    for name in options.cases:
        for threads in (1, 2) if name == "large" else (1,):
            case = child(threads, "--times", name, *(["--quick"] if options.quick else []))
            if name == "large" and threads == 1:
                for row in case["rows"]:
                    row["extra_mb"] = child(threads, "--memory", name, row["program"])
            cases.append(case)
    peers = ("numpy", "scipy", "iterative_ensemble_smoother", "pyesmda", "dageo")
    answer = {
        "schema": "tissuereg.benchmark-esmda/1",
        "command": " ".join(["python -m speed.esmda", *sys.argv[1:]]),
        "date": time.strftime("%Y-%m-%d"),
        "machine": machine(),
        "quick": options.quick,
        "versions": {"python": sys.version.split()[0], **{name: version(name) for name in ("tissuereg", *peers)}},
        "cases": cases,
    }
    if out is not None:
        from common import write_archive

        write_archive(out, answer, TABLES)
    if out == ARCHIVE:
        from readme import write_table

        write_table("esmda", table(answer), PAGE)
    sys.stdout.write(table(answer))


if __name__ == "__main__":
    main()
