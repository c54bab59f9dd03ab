"""Diagnoses stored cases and saves one JSON a case, so that an interrupted run can be resumed. Opens no answers."""

import argparse
import functools
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tissuereg as tr
from blind.materialise import folder_of
from blind.run import keep, read_list
from blind.variants import oracle_settings, without_settings
from common import commit
from rigs.materialise import case_names, materialise
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.errors import ClusterError
from tissuereg.io.json import plain
from tissuereg.parallel import Failed, Processes

BUILD = Path("build") / "rigs"
#: Folders, among the predictions, of answers without the hidden causes in the catalogue, and of fits of these alone;
#: what makes the settings from their ids.
WITHOUT, ORACLE = "without", "oracle"
OTHERS = {WITHOUT: without_settings, ORACLE: oracle_settings}


def diagnose(case: str, predictions: Path, work: Path, threads: int, settings: dict[str, DiagnoseSettings]) -> dict:
    """Return the answer on a case; runs once and saves the answer, whole or not at all.

    `settings`: those that are not the default ones, by case.
    """
    kept = predictions / f"{case}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    folder = folder_of(case, work, materialise)

    def ask() -> dict:
        own = settings.get(case, DEFAULT)
        return plain(tr.diagnose(tr.read_experiment(folder), threads=threads, settings=own).to_json())

    return keep(kept, ask, commit())


def answer_all(cases: list[str], jobs: int, **options: Any) -> Iterator[tuple[str, dict]]:
    """Yield every case with its answer as workers finish; `options`: of `diagnose`."""
    answered = functools.partial(_answered, options=options)
    with Processes(jobs) as executor:
        for outcome in executor.run(answered, cases):
            if isinstance(outcome, Failed):
                raise outcome.error
            yield outcome.result


def _answered(case: str, options: dict[str, Any]) -> tuple[str, dict]:
    return case, diagnose(case, **options)


def main() -> None:
    """Diagnose a half and print progress."""
    parser = argparse.ArgumentParser(prog="python -m rigs.run", description=__doc__)
    parser.add_argument("--half", choices=("dev", "sealed", "third", "all"), default="dev")
    parser.add_argument("--cases", nargs="+", help="names of cases, in place of a half")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--threads", type=int, default=1, help="threads of each")
    parser.add_argument("--predictions", type=Path, default=BUILD / "predictions")
    parser.add_argument("--work", type=Path, default=BUILD)
    parser.add_argument("--ids", type=Path, help="file of CASE ID,ID: the hidden causes")
    parser.add_argument("--method", choices=tuple(OTHERS), help="how those are asked about, in place of a half")
    options = parser.parse_args()
    if (options.ids is None) != (options.method is None):
        parser.error("--ids and --method are given together")
    of_ids = OTHERS.get(options.method)
    settings = {case: of_ids(ids) for case, ids in read_list(options.ids).items()} if of_ids else {}
    cases = [*settings] if of_ids else options.cases or case_names(options.half)
    # Workers import numpy anew: BLAS reads these at its start.
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("TISSUEREG_CACHE", str((options.work / "cache").resolve()))
    try:
        answers = answer_all(
            cases,
            options.jobs,
            predictions=options.predictions / (options.method or ""),
            work=options.work,
            threads=options.threads,
            settings=settings,
        )
        for number, (case, answer) in enumerate(answers, start=1):
            named = ", ".join(c["id"] for c in answer["causes"])
            print(f"{number}/{len(cases)} {case}: {answer['verdict']} {named} ({answer['seconds']:.1f} s)", flush=True)
    except (KeyboardInterrupt, ClusterError) as error:
        print(repr(error))
        sys.exit("stopped; finished answers are saved, and the same command resumes from there")


if __name__ == "__main__":
    main()
