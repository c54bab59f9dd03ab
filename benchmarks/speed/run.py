"""Times by stage on this machine, for the record: writes ``archive/stages``.

    python -m speed.run [--out FOLDER] [--reference DIR]

Runs ``tissuereg bench`` (solve, ensemble, esmda, register) and, where reference problems are at hand, times cold
solves of them and states the largest difference from the stored displacement for each.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from common import SHARED, write_archive

ARCHIVE, TABLES = Path(__file__).resolve().parent / "archive" / "stages", ("rows/#", "reference/#")


def command(*words: str) -> dict:
    """Return the JSON of a command."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        subprocess.run([sys.executable, "-m", "tissuereg", *words, "--json", str(answer)], check=True)
        return json.loads(answer.read_text(encoding="utf-8"))


def reference_rows(folder: Path, repeats: int) -> list[dict]:
    """Return one row a reference problem: cold seconds (median), counters, difference from the reference."""
    rows = []
    for path in sorted(folder.glob("*.npz")):
        with tempfile.TemporaryDirectory() as scratch:
            found = Path(scratch) / "u.npz"
            runs = [command("solve", str(path), "--out", str(found), "--tol", "1e-6") for _ in range(repeats)]
            with np.load(path) as given, np.load(found) as solved:
                difference = float(np.abs(solved["displacement_mm"] - given["displacement_mm"]).max())
        cold = [run["seconds"]["total"] - run["seconds"]["read"] - run["seconds"]["write"] for run in runs]
        rows.append(
            {
                "name": path.stem,
                "cold_s": {"minimum": min(cold), "median": float(np.median(cold)), "maximum": max(cold)},
                "stages_s": runs[int(np.argsort(cold)[len(cold) // 2])]["seconds"],
                "counters": {k: runs[0][k] for k in ("iterations", "solves", "factorisations", "load_steps")},
                "peak_mib": max(run["peak_mib"] for run in runs),
                "largest_difference_mm": difference,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ARCHIVE)
    parser.add_argument("--reference", type=Path, default=SHARED / "reference")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    answer = command("bench")
    answer["command"] = "python -m speed.run"
    answer["reference"] = reference_rows(options.reference, options.repeats)
    write_archive(options.out, answer, TABLES)
    for row in answer["rows"]:
        print(f"{row['name']:32s} {row['n_nodes'] or 0:7d} nodes  median {1000 * row['median_s']:9.2f} ms")
    for row in answer["reference"]:
        cold, off = 1000 * row["cold_s"]["median"], row["largest_difference_mm"]
        print(f"{row['name']:32s} cold {cold:9.1f} ms  off {off:.1e} mm")


if __name__ == "__main__":
    main()
