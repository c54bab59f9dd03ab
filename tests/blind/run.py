"""Runs a diagnoser over stored cases: one JSON a case, kept, so that a run that was stopped goes on.

Opens no answers. A diagnoser is a command (``{folder}``, ``{out}`` and ``{json}`` are filled in) or
``module:function``, which gets the folder and returns the dictionary.
"""

import argparse
import importlib
import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

from blind.materialise import DATA, case_names, materialise

TIERS = DATA / "tiers.json"
COMMAND = f"{shlex.quote(sys.executable)} -m tissuereg diagnose {{folder}} --out {{out}} --json {{json}}"
BUILD = Path("build") / "blind"

#: Seconds after which a case counts as not answered.
LIMIT = 600.0


def tier_cases(tier: str) -> list[str]:
    """Return the cases of a tier: quick, full (600-node bodies), fine (4,000 nodes) or all."""
    names = case_names()
    tiers = json.loads(TIERS.read_text(encoding="utf-8"))
    if tier == "all":
        return names
    if tier == "full":
        return [n for n in names if n not in tiers["fine"]]
    return [n for n in tiers[tier] if n in names]


def diagnose(case: str, diagnoser: str, predictions: Path, work: Path) -> dict:
    """Return what a diagnoser says about a case; asks it once and keeps the answer."""
    kept = predictions / f"{case}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    folder = work / "cases" / case
    if not (folder / "mesh.vtu").exists():
        materialise(case, folder)
    begun = time.perf_counter()
    try:
        answer = _asked(diagnoser, folder, work / "out" / case)
    except (subprocess.SubprocessError, json.JSONDecodeError, FileNotFoundError) as error:
        answer = {"verdict": "failed", "causes": [], "error": str(error)[-2000:]}
    answer["seconds"] = time.perf_counter() - begun
    predictions.mkdir(parents=True, exist_ok=True)
    partial = kept.with_suffix(".part")
    partial.write_text(json.dumps(answer), encoding="utf-8")
    partial.rename(kept)
    return answer


def _asked(diagnoser: str, folder: Path, out: Path) -> dict:
    if "{" not in diagnoser and ":" in diagnoser:
        module, name = diagnoser.split(":")
        return getattr(importlib.import_module(module), name)(folder)
    out.mkdir(parents=True, exist_ok=True)
    file = out / "diagnosis.json"
    words = shlex.split(diagnoser.format(folder=folder, out=out, json=file))
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, env=environment, check=False)
    if done.returncode:
        raise subprocess.SubprocessError(done.stderr or f"exit status {done.returncode}")
    return json.loads(file.read_text(encoding="utf-8"))


def main() -> None:
    """Run a tier and say how far it is."""
    parser = argparse.ArgumentParser(prog="python -m blind.run", description=__doc__)
    parser.add_argument("--tier", choices=("quick", "full", "fine", "all"), default="quick")
    parser.add_argument("--cases", help="file with names of cases, one a line, in place of a tier")
    parser.add_argument("--diagnoser", default=COMMAND)
    parser.add_argument("--predictions", type=Path, default=BUILD / "predictions")
    parser.add_argument("--work", type=Path, default=BUILD)
    options = parser.parse_args()
    cases = Path(options.cases).read_text(encoding="utf-8").split() if options.cases else tier_cases(options.tier)
    for number, case in enumerate(cases, start=1):
        answer = diagnose(case, options.diagnoser, options.predictions, options.work)
        named = ", ".join(c["id"] for c in answer["causes"])
        print(f"{number}/{len(cases)} {case}: {answer['verdict']} {named} ({answer['seconds']:.1f} s)", flush=True)


if __name__ == "__main__":
    main()
