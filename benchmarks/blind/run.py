"""Runs diagnosers over stored cases and saves one JSON a case, so that an interrupted run can be resumed.

Opens no answers. A diagnoser is a command (``{folder}``, ``{out}``, ``{json}`` and ``{threads}`` are filled in) or
``module:function``, which gets the folder, the ids it is given (none, or those of a list that the scorer wrote), and
``threads``, and returns the dictionary. Functions run in the worker itself, which imports the package once.

One worker runs all requested methods on a case, so that they share the cache of that case.
"""

import argparse
import functools
import importlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from blind.materialise import DATA, case_names, folder_of
from tissuereg.errors import ClusterError
from tissuereg.parallel import Failed, Processes

TIERS = DATA / "tiers.json"
SAMPLE = Path(__file__).resolve().parent / "sample.txt"
BUILD = Path("build") / "blind"

#: The diagnoser under test.
OURS = "blind.variants:ours"

#: Other methods, by the folder of their predictions; the first part of a name selects all that begin with it.
METHODS = {
    "oracle": "blind.variants:oracle",
    "without": "blind.variants:without",
    "rivals/sparse-regression": "blind.rivals:sparse_regression",
    "rivals/sparse-regression-on-fine-mesh": "blind.rivals:sparse_regression_on_fine_mesh",
    "rivals/error-ranking": "blind.rivals:error_ranking",
    "rivals/gaussian-process": "blind.rivals:gaussian_process",
    "ablations/no-mesh-correction": "blind.variants:no_mesh_correction",
    "ablations/no-third-mesh": "blind.variants:no_third_mesh",
    "ablations/no-forces": "blind.variants:no_forces",
    "ablations/no-proof": "blind.variants:no_proof",
    "ablations/no-mesh-nuisances": "blind.variants:no_mesh_nuisances",
}

#: Methods that are given ids: their lists, ``CASE ID,ID`` a line, lie in the work folder.
LISTS = {"oracle": "oracle.txt", "without": "without.txt"}

#: Seconds after which a case counts as not answered.
LIMIT = 600.0


@dataclass(frozen=True)
class Question:
    """One case for one diagnoser.

    Attributes
    ----------
    case : str
        Its name.
    diagnoser : str
        Command, or ``module:function``.
    kept : Path
        File of the answer.
    ids : tuple of str
        Ids that a function is given.
    """

    case: str
    diagnoser: str
    kept: Path
    ids: tuple[str, ...] = ()


def tier_cases(tier: str) -> list[str]:
    """Return the cases of a tier: quick, sample, full (600-node bodies), fine (4,000 nodes) or all."""
    names = case_names()
    if tier == "sample":
        return SAMPLE.read_text(encoding="utf-8").split()
    tiers = json.loads(TIERS.read_text(encoding="utf-8"))
    if tier == "all":
        return names
    if tier == "full":
        return [n for n in names if n not in tiers["fine"]]
    return [n for n in tiers[tier] if n in names]


def diagnose(question: Question, work: Path, threads: int = 0) -> dict:
    """Return a diagnoser's answer on a case; runs it once and saves the answer, whole or not at all."""
    kept = question.kept
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    folder = folder_of(question.case, work)
    return keep(kept, lambda: _run(question, folder, work / "out" / question.case, threads), {"commit": _commit()})


def keep(kept: Path, ask: Callable[[], dict], stamp: dict) -> dict:
    """Return what `ask` answers, with seconds, stamp and date, and save it, whole or not at all."""
    begun = time.perf_counter()
    try:
        answer = ask()
    except Exception as error:
        # An exception of the diagnoser is recorded as its answer.
        answer = {"verdict": "failed", "causes": [], "error": f"{type(error).__name__}: {error}"[-2000:]}
    answer["seconds"] = time.perf_counter() - begun
    answer |= stamp
    answer["date"] = datetime.now(UTC).isoformat(timespec="seconds")
    kept.parent.mkdir(parents=True, exist_ok=True)
    partial = kept.with_suffix(".part")
    partial.write_text(json.dumps(answer), encoding="utf-8")
    partial.rename(kept)
    return answer


def _run(question: Question, folder: Path, out: Path, threads: int) -> dict:
    function = function_of(question.diagnoser)
    if function is not None:
        signal.signal(signal.SIGALRM, _too_long)
        signal.setitimer(signal.ITIMER_REAL, LIMIT)
        try:
            return function(folder, question.ids, threads=threads)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    out.mkdir(parents=True, exist_ok=True)
    file = out / "diagnosis.json"
    file.unlink(missing_ok=True)
    words = shlex.split(question.diagnoser.format(folder=folder, out=out, json=file, threads=threads))
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, check=False)
    if done.returncode:
        raise subprocess.SubprocessError(done.stderr or f"exit status {done.returncode}")
    return json.loads(file.read_text(encoding="utf-8"))


def _too_long(*_: object) -> None:
    message = f"no answer in {LIMIT:g} s"
    raise TimeoutError(message)


def function_of(diagnoser: str):
    """Return the function that ``module:function`` names; None for a command."""
    if "{" in diagnoser or ":" not in diagnoser:
        return None
    module, name = diagnoser.split(":")
    return getattr(importlib.import_module(module), name)


@functools.cache
def _commit() -> str:
    """Return the commit in use, marked if files differ from it."""
    words = ["git", "-C", str(DATA), "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def questions_of(cases: list[str], methods: list[str], diagnoser: str, predictions: Path, work: Path) -> list[Question]:
    """Return the cases to run; methods that are given ids run on the cases of their lists alone.

    Parameters
    ----------
    cases : list of str
        Names, in the order of the questions.
    methods : list of str
        Names of `METHODS` or first parts of them; if empty, the diagnoser itself runs.
    diagnoser : str
        Command, or ``module:function``.
    predictions, work : Path
        Folders of the answers, and of the lists.

    Raises
    ------
    ValueError
        If a method is not known.
    FileNotFoundError
        If the list of a method does not exist.
    """
    if not methods:
        return [Question(case, diagnoser, predictions / f"{case}.json") for case in cases]
    chosen = [name for name in METHODS if name in methods or name.partition("/")[0] in methods]
    if unknown := [m for m in methods if not any(m in (name, name.partition("/")[0]) for name in METHODS)]:
        message = f"methods must be among {', '.join(METHODS)} or their first parts; got {', '.join(unknown)}"
        raise ValueError(message)
    lists = {name: read_list(work / LISTS[name]) for name in chosen if name in LISTS}
    return [
        Question(case, METHODS[name], predictions / name / f"{case}.json", lists.get(name, {}).get(case, ()))
        for case in cases
        for name in chosen
        if name not in lists or case in lists[name]
    ]


def read_list(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the ids that a list gives to each case, ``CASE ID,ID`` a line."""
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    return {case: tuple(ids.split(",")) for case, ids in rows}


def answer_all(questions: list[Question], work: Path, jobs: int) -> Iterator[tuple[Question, dict]]:
    """Yield every question with its answer as workers finish; several workers have one thread each."""
    by_case: dict[str, list[Question]] = {}
    for question in questions:
        by_case.setdefault(question.case, []).append(question)
    answered = functools.partial(_diagnose_case, work=work, threads=0 if jobs == 1 else 1)
    with Processes(jobs) as executor:
        for outcome in executor.run(answered, by_case.values()):
            if isinstance(outcome, Failed):
                raise outcome.error
            yield from outcome.result


def _diagnose_case(questions: list[Question], work: Path, threads: int) -> list[tuple[Question, dict]]:
    return [(question, diagnose(question, work, threads)) for question in questions]


def main() -> None:
    """Run a tier and print its progress."""
    parser = argparse.ArgumentParser(prog="python -m blind.run", description=__doc__)
    parser.add_argument("--tier", choices=("quick", "sample", "full", "fine", "all"), default="quick")
    parser.add_argument("--cases", help="file with names of cases, one per line, in place of a tier")
    parser.add_argument("--diagnoser", default=OURS)
    parser.add_argument("--methods", nargs="+", default=[], help=f"in place of the diagnoser: {', '.join(METHODS)}")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time; more than one: one thread each")
    parser.add_argument("--predictions", type=Path, default=BUILD / "predictions")
    parser.add_argument("--work", type=Path, default=BUILD)
    options = parser.parse_args()
    cases = Path(options.cases).read_text(encoding="utf-8").split() if options.cases else tier_cases(options.tier)
    questions = questions_of(cases, options.methods, options.diagnoser, options.predictions, options.work)
    for diagnoser in {question.diagnoser for question in questions}:
        function_of(diagnoser)  # a misspelt name fails before anything runs
    # Workers import numpy anew: BLAS reads these at its start.
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("TISSUEREG_CACHE", str((options.work / "cache").resolve()))
    try:
        for number, (question, answer) in enumerate(answer_all(questions, options.work, options.jobs), start=1):
            named = ", ".join(c["id"] for c in answer["causes"])
            where = question.kept.relative_to(options.predictions).with_suffix("")
            print(
                f"{number}/{len(questions)} {where}: {answer['verdict']} {named} ({answer['seconds']:.1f} s)",
                flush=True,
            )
    except (KeyboardInterrupt, ClusterError):
        sys.exit("stopped; finished answers are saved, and the same command resumes from there")


if __name__ == "__main__":
    main()
