"""What Dask costs and gives: ``make bench-cluster`` -> ``benchmarks/results/cluster.json`` and ``docs/cluster.md``.

One process, ``local:1`` and ``local:2`` make the same data set in turns, so that what else the machine does falls on
all, with the mesh analysed before, as in a long run. Then empty tasks.
"""

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median

import cloudpickle

from tissuereg._machine import machine, versions
from tissuereg.parallel import InProcess, open_executor
from tissuereg.parallel.cluster import _work
from tissuereg.simulate.chunks import ChunkTask, make_one_chunk
from tissuereg.simulate.dataset import make_dataset
from tissuereg.simulate.recipe import read_recipe

RECIPE = Path(__file__).resolve().parent.parent / "training" / "recipes" / "breast.toml"
OUT = Path(__file__).resolve().parent / "results" / "cluster.json"


def nothing(task: int) -> int:
    """Return an empty task's number."""
    return task


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=6, help="chunks of 16 members a run")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--tasks", type=int, default=5000, help="empty tasks")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, open_executor("local:1") as one, open_executor("local:2") as two:
        recipe = small(Path(scratch), 16 * options.chunks)
        ways = {"in this process": InProcess(), "local:1": one, "local:2": two}
        runs: dict[str, list[dict]] = {name: [] for name in ways}
        for repeat in range(options.repeats + 1):
            for name, executor in ways.items():
                folder = Path(scratch) / "data"
                made = make_dataset(recipe, folder, threads=1, executor=executor)
                chunk_bytes = max(file.stat().st_size for file in folder.glob("chunk_*"))
                shutil.rmtree(folder)
                if repeat:  # the first one analyses the mesh and loads the libraries
                    runs[name].append({"solve_s": made["seconds"]["solve"], "overhead": made["overhead"]})
        begun = time.perf_counter()
        n_done = sum(1 for _ in two.run(nothing, range(options.tasks)))
        rate = n_done / (time.perf_counter() - begun)
        task = ChunkTask(recipe.raw, "0" * 64, 0, 10**6, "s3://bucket/folder/of/data", 1)
        report = sample_report(recipe, Path(scratch))
    seconds = {name: [run["solve_s"] for run in some] for name, some in runs.items()}
    single = seconds["in this process"]
    content = {
        "recipe": recipe.raw,
        "members_a_chunk": 16,
        "chunks_a_run": options.chunks,
        "runs": runs,
        "chunk_s": {name: median(some) / options.chunks for name, some in seconds.items()},
        "least_chunk_s": {name: min(some) / options.chunks for name, some in seconds.items()},
        "overhead_of_local_1": median(b / a for a, b in zip(single, seconds["local:1"], strict=True)) - 1.0,
        "overhead_of_local_1_least": min(seconds["local:1"]) / min(single) - 1.0,
        "two_workers_over_one": median(a / b for a, b in zip(seconds["local:1"], seconds["local:2"], strict=True)),
        "empty_tasks_per_s": rate,
        "task_bytes": len(cloudpickle.dumps((_work, make_one_chunk, task, "t" * 42, "k" * 32, False))),
        "report_bytes": len(cloudpickle.dumps((True, report))),
        "chunk_bytes": chunk_bytes,
        "machine": machine(),
        "versions": versions(),
    }
    OUT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({key: content[key] for key in content if key not in ("recipe", "machine", "versions")}, indent=1))


def small(folder: Path, members: int):
    """Return the recipe of the large data set, with few members and no pairs."""
    import re

    text = RECIPE.read_text(encoding="utf-8")
    text = re.sub(r"(?m)^members = .*$", f"members = {members}", text, count=1)
    text = re.sub(r"(?m)^chunk = .*$", "chunk = 16", text, count=1)
    text = re.sub(r"(?s)\[pairs\].*?(?=\n\[|\Z)", "[pairs]\nmembers = 0\n", text)
    (folder / "recipe.toml").write_text(text, encoding="utf-8")
    return read_recipe(folder / "recipe.toml")


def sample_report(recipe, folder: Path):
    """Return the report of a chunk."""

    class Kept(InProcess):
        def run(self, function, tasks):
            for outcome in super().run(function, tasks):
                self.last = outcome.result
                yield outcome

    kept = Kept()
    make_dataset(recipe, folder / "report", threads=1, executor=kept)
    return kept.last


if __name__ == "__main__":
    main()
