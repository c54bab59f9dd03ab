"""A training data set: thousands of solves on one mesh, in files (chunks) of some hundred, safe against interruption.

`docs/files.md` describes the folder. A chunk depends on the recipe, the seed and its own number alone
(`tissuereg.simulation.chunks`), so a resumed run makes the same data as an uninterrupted one, and so do many processes.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from tissuereg._base.arguments import called, check_running, of_kind
from tissuereg._base.clock import Clock
from tissuereg._version import __version__
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ClusterError, EnsembleError, ExperimentError, FormatError, TissueRegError
from tissuereg.io.chunks import chunk_name
from tissuereg.io.datasets import CARD_NAME, DATASET_SCHEMA, MESH_NAME, pack_mesh, read_card, split_of
from tissuereg.io.json import dumps
from tissuereg.io.stores import Store, store_of
from tissuereg.parallel import Executor, Failed, one_result
from tissuereg.simulation.chunks import ChunkReport, ChunkTask, chunk_maker, data_mark, make_one_chunk
from tissuereg.simulation.motion import motion_summary
from tissuereg.simulation.pairs import PAIRS_NAME, PairsReport, make_pairs
from tissuereg.simulation.recipe import Recipe
from tissuereg.simulation.settings import DATA_SET

Progress = Callable[[int, int], None]

#: Marks the place as that of a data set, before anything else is there.
_MARKER = "recipe.sha256"


def make_dataset(
    recipe: Recipe,
    out: str | os.PathLike[str],
    *,
    seed: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Make a data set of simulations (members) under random loads, or resume an unfinished one.

    `recipe`: recipe of the data set: mesh, material, random loads, pairs; `out`: folder, or a URL of fsspec; chunks
    (files of members) already there are kept; `seed`: seed of all random numbers; by default the recipe's; `threads`:
    threads of a chunk; 0 takes all cores. The data do not depend on it; `progress`: called with the number of
    simulations done and the number of all simulations, two a pair included; `executor`: where chunks are made, each as
    a separate task that writes its file itself. By default in this process. Result: ``members`` (number with
    equilibrium), ``failed`` (list of [index, reason]), ``members_per_s`` (None if all were there), ``motion``
    (statistics of the displacements in mm, see `tissuereg.simulation.motion.motion_summary`), ``bytes``, ``seconds``
    (dict of wall times by stage), ``seed``, and ``overhead``, the share of the workers' time that made no chunk (None
    without an executor, or where none of its workers was counted). Raises `ExperimentError` if the folder holds other
    files, or another recipe's data; `FormatError` if a chunk, or the pairs, that are there already are spoilt, or no
    longer those of a card (``dataset.json``) that is there; `EnsembleError` if more than half of a chunk of at least
    eight members fails, or of the whole; `OutputError` if nothing can be written there; `ClusterError` if the workers
    are lost, or some chunks could not be made on them; the others are kept.
    """
    of_kind("recipe", recipe, Recipe)
    check_running(seed=0 if seed is None else seed, threads=threads)
    called("progress", progress)
    if executor is not None:
        of_kind("executor", executor, Executor)
    store, clock = store_of(out), Clock()
    seed = recipe.seed if seed is None else seed
    in_all = recipe.data.members + 2 * recipe.pairs.members
    with clock.stage("total"):
        with clock.stage("analyse"):
            mesh = recipe.mesh()
            mark = _begin(store, recipe, mesh, seed)
            n_chunks = _n_chunks(recipe)
            task_of = partial(_task, recipe.raw, mark, seed, store.address, threads)
            if executor is None:
                chunk_maker(task_of(0))
        reports: dict[int, ChunkReport] = {}
        done, before = 0, 0.0 if executor is None else executor.worker_seconds
        with clock.stage("solve"):
            for report in _made(map(task_of, range(n_chunks)), recipe, executor, _from(progress, in_all)):
                reports[report.number] = report
                done += report.members + len(report.failed)
                if progress is not None:
                    progress(done, in_all)
        overhead = None
        if executor is not None:
            spent = executor.worker_seconds - before
            if spent > 0.0:
                overhead = 1.0 - sum(report.seconds for report in reports.values()) / spent
        pairs = None
        with clock.stage("pairs"):
            if recipe.pairs.members:
                if executor is None:
                    after = _from(progress, in_all)
                    pairs = make_pairs(task_of(0), None if after is None else partial(after, recipe.data.members))
                else:
                    pairs = one_result(executor, make_pairs, task_of(0))
        if progress is not None:
            progress(in_all, in_all)
        in_order = [reports[number] for number in range(n_chunks)]
        _check_enough(in_order)
        _check_unchanged(store, in_order, pairs)
        card = _card(recipe, mesh, mark, seed, in_order, pairs)
        store.write(CARD_NAME, dumps(card).encode())
    fresh = sum(report.members + len(report.failed) for report in in_order if report.made)
    return {
        "members": card["members"],
        "failed": card["failed"],
        "members_per_s": fresh / clock.seconds["solve"] if fresh else None,
        "motion": card["motion"],
        "bytes": card["bytes"],
        "overhead": overhead,
        "seconds": clock.seconds,
        "seed": seed,
    }


def size_line(recipe: Recipe, out: str | os.PathLike[str]) -> str:
    """Return one line of text with the size of a data set: simulations, nodes, MB on disk, files, files present."""
    data, n_nodes = recipe.data, recipe.mesh().n_nodes
    n_bytes = 12 * n_nodes * (data.members + 2 * recipe.pairs.members)
    n_chunks = _n_chunks(recipe)
    present = len(store_of(out).names() & {chunk_name(number) for number in range(n_chunks)})
    size = f"{n_bytes / 1e6:.{1 if n_bytes < 1e7 else 0}f} MB"
    return f"{data.members} simulations on {n_nodes} nodes, about {size} in {n_chunks} files" + (
        f", {present} of which are there" if present else ""
    )


def _n_chunks(recipe: Recipe) -> int:
    return -(-recipe.data.members // recipe.data.chunk)


def _from(progress: Progress | None, in_all: int) -> Callable[[int, int], None] | None:
    return None if progress is None else (lambda first, done: progress(first + done, in_all))


def _task(recipe: dict[str, Any], mark: str, seed: int, address: str, threads: int, number: int) -> ChunkTask:
    return ChunkTask(recipe, mark, seed, number, address, threads)


def _made(
    tasks: Iterable[ChunkTask], recipe: Recipe, executor: Executor | None, within: Callable[[int, int], None] | None
) -> Iterator[ChunkReport]:
    """Make the chunks (files of simulations) of the tasks, and yield the report of each as soon as it is written.

    `executor`: where they are made, in this process if None; `within`: called, in this process only, with the number of
    the chunk's first member and the number of its members done. Raises the task's error if a chunk cannot be made at
    all; `ClusterError` if chunks failed on workers.
    """
    if executor is None:
        for task in tasks:
            first = task.number * recipe.data.chunk
            yield make_one_chunk(task, None if within is None else partial(within, first))
        return
    n_made, failed = 0, list[Failed]()
    for outcome in executor.run(make_one_chunk, tasks):
        if not isinstance(outcome, Failed):
            n_made += 1
            yield outcome.result
            continue
        failed.append(outcome)
        lasting = isinstance(outcome.error, TissueRegError) and not isinstance(outcome.error, ClusterError)
        if lasting or len(failed) >= n_made + DATA_SET.most_failed:
            raise outcome.error
    if failed:
        numbers = ", ".join(str(one.index) for one in failed[:10])
        message = (
            f"every chunk must be made; {len(failed)} could not be, the first of them {numbers}: "
            f"{failed[0].error}. The others are kept; run the same command again"
        )
        raise ClusterError(message) from failed[0].error


def _begin(store: Store, recipe: Recipe, mesh: Mesh, seed: int) -> str:
    """Mark the place as this recipe's, or refuse it; return the fingerprint (SHA-256, hexadecimal) of the data set.

    An empty place receives the mesh. Raises `ExperimentError` if it holds other files or another data set.
    """
    mark = data_mark(recipe, mesh, seed)
    store.check()
    if not store.exists(_MARKER):
        if store.names():
            message = f"{store.url} must be empty or hold a data set; it holds other files"
            raise ExperimentError(message, where=store.url)
        # First of all: a run that is killed after it is gone on with.
        store.write(_MARKER, f"{mark}\n".encode())
    elif store.read(_MARKER).decode("utf-8", "replace").strip() != mark:
        if store.exists(CARD_NAME):
            read_card(store)  # says so if it is an older form
        message = (
            f"{store.url} must be empty or hold data of this very recipe, seed, mesh and version; it holds another's"
        )
        raise ExperimentError(message, where=store.url)
    if not store.exists(MESH_NAME):
        store.write(MESH_NAME, pack_mesh(mesh))
    return mark


def _check_enough(reports: list[ChunkReport]) -> None:
    """Refuse a data set of which more than half of the members have failed, summed over all chunks.

    This catches chunks that are too small to be judged alone. Raises `EnsembleError`.
    """
    failed = [one for report in reports for one in report.failed]
    solved = sum(report.members for report in reports)
    if solved < len(failed):
        message = (
            f"at least half of the members must find equilibrium, {solved} of {solved + len(failed)} did; lower [data] "
            "largest_mm"
        )
        raise EnsembleError(message, dropped=failed)


def _check_unchanged(store: Store, reports: list[ChunkReport], pairs: PairsReport | None) -> None:
    """Refuse existing files that differ from those of an existing card, so that a new card does not certify them.

    The card (``dataset.json``) lists the SHA-256 of every file. Raises `FormatError` if one differs.
    """
    try:
        card = read_card(store)
    except FormatError:
        return  # there is none, or it says nothing
    told = {entry["file"]: entry["sha256"] for entry in (*card["chunks"], card["pairs"]) if entry}
    found = {chunk_name(report.number): report.sha256 for report in reports if not report.made}
    if pairs is not None and not pairs.made:
        found[PAIRS_NAME] = pairs.sha256
    for name, sha256 in found.items():
        if told.get(name, sha256) != sha256:
            where = store.where(name)
            message = (
                f"{where} must be the file that was written; its SHA-256 has changed. Delete it, and the same command "
                "makes it anew"
            )
            raise FormatError(message, where=where)


def _card(
    recipe: Recipe, mesh: Mesh, mark: str, seed: int, reports: list[ChunkReport], pairs: PairsReport | None
) -> dict[str, Any]:
    import h5py
    import numpy as np

    mesh_file = pack_mesh(mesh)
    members = sum(report.members for report in reports)
    entries = [
        {"file": chunk_name(r.number), "members": r.members, "bytes": r.n_bytes, "sha256": r.sha256} for r in reports
    ]
    card = {
        "schema": DATASET_SCHEMA,
        "recipe": recipe.raw,
        "recipe_sha256": mark,
        "seed": seed,
        "members": members,
        "failed": [[index, reason] for report in reports for index, reason in report.failed],
        "mesh": {
            "file": MESH_NAME,
            "n_nodes": mesh.n_nodes,
            "n_tets": mesh.n_tets,
            "digest": mesh.digest(),
            "bytes": len(mesh_file),
            "sha256": hashlib.sha256(mesh_file).hexdigest(),
        },
        "chunks": entries,
        "pairs": None if pairs is None else {"file": PAIRS_NAME, "bytes": pairs.n_bytes, "sha256": pairs.sha256},
        "split": {name: rows.tolist() for name, rows in split_of(members, seed).items()},
        "motion": motion_summary([report.motion for report in reports]),
        "versions": {"tissuereg": __version__, "numpy": np.__version__, "h5py": h5py.__version__},
    }
    card["bytes"] = len(mesh_file) + sum(r.n_bytes for r in reports) + (0 if pairs is None else pairs.n_bytes)
    return card
