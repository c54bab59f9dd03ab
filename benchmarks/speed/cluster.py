"""What Dask costs and gives -> archive/cluster, RESULTS-cluster.md.

    python -m speed.cluster           # measure and write both
    python -m speed.cluster --page    # write the page of the figures that are there

One process, ``local:1`` and ``local:2`` make the same data set in turns, so that what else the machine does falls on
all, with the mesh analysed before, as in a long run. Then empty tasks.
"""

import argparse
import json
import os
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median

import cloudpickle

from common import REPOSITORY, read_archive, write_archive
from tissuereg._base.machine import machine, versions
from tissuereg.parallel import InProcess, open_executor
from tissuereg.parallel.cluster import _work
from tissuereg.simulation.chunks import ChunkTask, make_one_chunk
from tissuereg.simulation.dataset import make_dataset
from tissuereg.simulation.recipe import read_recipe

RECIPE = REPOSITORY / "training" / "recipes" / "breast.toml"
HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive" / "cluster", HERE / "RESULTS-cluster.md"
TABLES = ("runs/<way>/#",)

#: Load of the machine, processes, above which others worked on it as well.
_BUSY = 0.3

#: The large set of the page: members, workers, and the size of chunks that suits it.
_MEMBERS, _WORKERS, _LARGE = 10**7, 1000, 256


def nothing(task: int) -> int:
    """Return an empty task's number."""
    return task


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=6, help="chunks of 16 members a run")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--tasks", type=int, default=5000, help="empty tasks")
    parser.add_argument("--page", action="store_true", help="measure nothing: write the page of what was measured")
    options = parser.parse_args()
    if not options.page:
        measure(options.chunks, options.repeats, options.tasks)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


def measure(n_chunks: int, repeats: int, n_tasks: int) -> None:
    """Measure, and write the archive."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as scratch, open_executor("local:1") as one, open_executor("local:2") as two:
        recipe = small(Path(scratch), 16 * n_chunks)
        ways = {"in this process": InProcess(), "local:1": one, "local:2": two}
        runs: dict[str, list[dict]] = {name: [] for name in ways}
        for repeat in range(repeats + 1):
            for name, executor in ways.items():
                folder = Path(scratch) / "data"
                made = make_dataset(recipe, folder, threads=1, executor=executor)
                chunk_bytes = max(file.stat().st_size for file in folder.glob("chunk_*"))
                shutil.rmtree(folder)
                if repeat:  # the first one analyses the mesh and loads the libraries
                    runs[name].append({"solve_s": made["seconds"]["solve"], "overhead": made["overhead"]})
        begun = time.perf_counter()
        n_done = sum(1 for _ in two.run(nothing, range(n_tasks)))
        rate = n_done / (time.perf_counter() - begun)
        task = ChunkTask(recipe.raw, "0" * 64, 0, 10**6, "s3://bucket/folder/of/data", 1)
        report = sample_report(recipe, Path(scratch))
    seconds = {name: [run["solve_s"] for run in some] for name, some in runs.items()}
    single = seconds["in this process"]
    content = {
        "recipe": recipe.raw,
        "load_before": load,
        "members_a_chunk": 16,
        "chunks_a_run": n_chunks,
        "runs": runs,
        "chunk_s": {name: median(some) / n_chunks for name, some in seconds.items()},
        "least_chunk_s": {name: min(some) / n_chunks for name, some in seconds.items()},
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
    write_archive(ARCHIVE, content, TABLES)
    print(json.dumps({key: content[key] for key in content if key not in ("recipe", "machine", "versions")}, indent=1))


def page(answer: dict) -> str:
    """Return the page of an archive."""
    chunk, least = answer["chunk_s"], answer["least_chunk_s"]
    members, cores = answer["members_a_chunk"], answer["machine"]["cores"]
    load = answer["load_before"]
    busy = "" if load is not None and load <= _BUSY else " that were busy with other work as well"
    rows = {
        "a chunk in one process: median, least": f"{chunk['in this process']:.3f} s, {least['in this process']:.3f} s",
        "the same on `local:1`": f"{chunk['local:1']:.3f} s, {least['local:1']:.3f} s",
        "more than in one process: median of pairs, least over least": (
            f"{100 * answer['overhead_of_local_1']:+.1f}%, {100 * answer['overhead_of_local_1_least']:+.1f}%"
        ),
        "`local:2` over `local:1`": f"{answer['two_workers_over_one']:.2f} times as fast",
        "empty tasks through the scheduler": f"{answer['empty_tasks_per_s']:.0f} a second",
        "a chunk's task and report": f"{answer['task_bytes'] / 1e3:.1f} and {answer['report_bytes'] / 1e3:.1f} kB",
        "a chunk's file": f"{answer['chunk_bytes'] / 1e6:.1f} MB",
    }
    table = "\n".join(["| | |", "| --- | --- |", *(f"| {name} | {found} |" for name, found in rows.items())])
    return f"""# Many machines: what it costs

Measured by `make -C benchmarks/speed cluster` on {cores} cores{busy}, chunks of {members} members on the breast mesh of
the large recipe, runs in turns (`archive/cluster`). How to use them: `docs/cluster.md`.

{table}

{_on_paper(answer)}"""


def _on_paper(answer: dict) -> str:
    """Return what the figures mean for a large set."""
    seconds, members, rate = (
        answer["chunk_s"]["in this process"],
        answer["members_a_chunk"],
        answer["empty_tasks_per_s"],
    )
    n_chunks, asked, larger = _MEMBERS // members, _WORKERS / seconds, _LARGE / members
    hours, wire = n_chunks * seconds / 3600, answer["task_bytes"] + answer["report_bytes"]
    kept = n_chunks * answer["report_bytes"] / 1e9

    def held(each: float) -> str:
        return "keeps up with" if each < rate else "does not keep up with"

    return f"""## {_WORKERS:,} workers and {_MEMBERS // 10**6} million members, on paper

From these figures: {n_chunks:,} chunks of {seconds:.2f} s are {hours:.0f} core hours, {hours / _WORKERS:.2f} hours on {_WORKERS:,} workers. What breaks first:

1. **The destination.** {_WORKERS:,} workers write {asked:.0f} files and {asked * answer["chunk_bytes"] / 1e6:.0f} MB a second, {n_chunks * answer["chunk_bytes"] / 1e12:.1f} TB in all, in one folder.
   A shared file system gives way at the number of files before the scheduler does; object stores limit requests of one prefix to some thousands.
   Larger chunks help: with `chunk = {_LARGE}`, {asked / larger:.0f} files a second.
2. **The scheduler.** {asked:.0f} tasks a second are asked of {rate:.0f} here, where client, scheduler and workers shared the cores.
   It {held(asked)} chunks of {members}, and {held(asked / larger)} `chunk = {_LARGE}`, which asks {asked / larger:.0f}.
3. **The network of the scheduler** is idle: {asked * wire / 1e6:.1f} MB a second.
4. **The client** keeps a report a chunk: {kept:.1f} GB for chunks of {members}, and the card `dataset.json` an entry each. With
   `chunk = {_LARGE}` it is {kept / larger:.2f} GB.
"""  # noqa: E501 (a page's lines)


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
