"""Diagnoses stored cases and saves one JSON a case, so that an interrupted run can be resumed. Opens no answers."""

import argparse
import functools
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import tissuereg as tr
from blind.materialise import folder_of
from blind.run import keep
from common import commit
from rigs.materialise import case_names, materialise
from tissuereg.errors import ClusterError
from tissuereg.io.json import plain
from tissuereg.parallel import Failed, Processes

BUILD = Path("build") / "rigs"


def diagnose(case: str, predictions: Path, work: Path, threads: int) -> dict:
    """Return the answer on a case; runs once and saves the answer, whole or not at all."""
    kept = predictions / f"{case}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    folder = folder_of(case, work, materialise)
    return keep(kept, lambda: plain(tr.diagnose(tr.read_experiment(folder), threads=threads).to_json()), commit())


def answer_all(cases: list[str], predictions: Path, work: Path, jobs: int, threads: int) -> Iterator[tuple[str, dict]]:
    """Yield every case with its answer as workers finish."""
    answered = functools.partial(_answered, predictions=predictions, work=work, threads=threads)
    with Processes(jobs) as executor:
        for outcome in executor.run(answered, cases):
            if isinstance(outcome, Failed):
                raise outcome.error
            yield outcome.result


def _answered(case: str, predictions: Path, work: Path, threads: int) -> tuple[str, dict]:
    return case, diagnose(case, predictions, work, threads)


def main() -> None:
    """Diagnose a half and print progress."""
    parser = argparse.ArgumentParser(prog="python -m rigs.run", description=__doc__)
    parser.add_argument("--half", choices=("dev", "sealed", "third", "all"), default="dev")
    parser.add_argument("--cases", nargs="+", help="names of cases, in place of a half")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--threads", type=int, default=1, help="threads of each")
    parser.add_argument("--predictions", type=Path, default=BUILD / "predictions")
    parser.add_argument("--work", type=Path, default=BUILD)
    options = parser.parse_args()
    cases = options.cases or case_names(options.half)
    # Workers import numpy anew: BLAS reads these at its start.
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("TISSUEREG_CACHE", str((options.work / "cache").resolve()))
    try:
        answers = answer_all(cases, options.predictions, options.work, options.jobs, options.threads)
        for number, (case, answer) in enumerate(answers, start=1):
            named = ", ".join(c["id"] for c in answer["causes"])
            print(f"{number}/{len(cases)} {case}: {answer['verdict']} {named} ({answer['seconds']:.1f} s)", flush=True)
    except (KeyboardInterrupt, ClusterError) as error:
        print(repr(error))
        sys.exit("stopped; finished answers are saved, and the same command resumes from there")


if __name__ == "__main__":
    main()
