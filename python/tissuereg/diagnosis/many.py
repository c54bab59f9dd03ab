"""Diagnoses of many experiments, each on its own, kept as they come."""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.arguments import found, of_kind, place
from tissuereg._base.choices import Element
from tissuereg._base.machine import machine, versions
from tissuereg._version import __version__
from tissuereg.diagnosis import check_asked, diagnose
from tissuereg.errors import ArgumentError
from tissuereg.io.atomic import OutputError, check_folder_target
from tissuereg.io.experiments import is_material_test, read_experiment
from tissuereg.io.material_experiments import read_material_experiment
from tissuereg.parallel import Executor, Failed, InProcess, in_order

if TYPE_CHECKING:
    from tissuereg.diagnosis.settings import DiagnoseSettings

#: Entry of ``diagnosis.json`` that says what it was made from.
_MARK = "given_sha256"


@dataclass(frozen=True)
class Diagnosed:
    """One experiment whose diagnosis is written.

    Attributes
    ----------
    name : str
        Name of the experiment's folder, and of its results.
    folder : Path
        Folder in which ``diagnosis.json``, ``experiment.extended.toml`` and ``report.html`` lie.
    answer : dict
        Content of ``diagnosis.json``, schema ``tissuereg.diagnosis/1``.
    made : bool
        True if the diagnosis was made now, False if it was there already.
    """

    name: str
    folder: Path
    answer: dict[str, Any]
    made: bool

    @property
    def verdict(self) -> str:
        """Verdict of the diagnosis, as `Diagnosis.verdict`."""
        return str(self.answer["verdict"])


def diagnose_many(
    experiments: Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    executor: Executor | None = None,
    seed: int = 0,
    threads: int | None = None,
    keep: bool = True,
    element: Element | None = None,
    progress: Callable[[int, int], None] | None = None,
    settings: "DiagnoseSettings | None" = None,
) -> Iterator[Diagnosed | Failed]:
    """Diagnose many experiments and write each result into a folder of its own.

    A diagnosis that is there is not made again, if it was made from the same files with the same settings and version:
    so a run that was stopped goes on.

    Parameters
    ----------
    experiments : iterable of path-like
        Experiment folders, or files in them, of bodies or material tests. Their names must differ.
    out : path-like
        Folder of the results, which lie in ``out/NAME``; NAME is that of the experiment's folder. Workers on other
        machines must reach it and the experiments by the same paths.
    executor : tissuereg.parallel.Executor, optional
        Processes or machines that make the diagnoses. By default they are made in this process, one after another.
    seed, keep, element, settings
        Seed of all random draws; whether the bank of hypotheses and the predictions on fine meshes are cached; elements
        of the believed model of a body; all numbers that may change a result. Types and defaults are those of
        `diagnose`.
    threads : int, optional
        Threads of a diagnosis; 0 takes all cores. By default 0, and 1 where there is an `executor`.
    progress : callable of (int, int), optional
        Called with the number of experiments that are done, and the number of all.

    Yields
    ------
    Diagnosed or Failed
        One for each experiment, in their order; `Failed` has the error of one that could not be diagnosed, which is
        tried again by the next run.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or is out of range, or two experiments have one name.
    OutputError
        If nothing can be written to `out`.
    ClusterError
        If the executor loses its workers.
    """
    default = 0 if executor is None else 1
    n_threads = default if threads is None else threads
    numbers = check_asked(settings, seed=seed, threads=n_threads, keep=keep, element=element, progress=progress)
    runs = InProcess() if executor is None else of_kind("executor", executor, Executor)
    if isinstance(experiments, str | bytes) or not isinstance(experiments, Iterable):
        message = f"`experiments` must be a list of paths, got {found(experiments)}"
        raise ArgumentError(message, where="experiments")
    paths = [place("experiments", one).absolute() for one in experiments]
    target = place("out", out, error=OutputError).absolute()
    check_folder_target(target)
    names = [_name(path) for path in paths]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        message = f"`experiments` must have names that differ, as their results have; twice: {', '.join(twice)}"
        raise ArgumentError(message, where="experiments")
    tasks = [
        _DiagnosisTask(path, name, target / name, seed, n_threads, keep, element, numbers)
        for path, name in zip(paths, names, strict=True)
    ]
    return _diagnosed(tasks, runs, progress)


@dataclass(frozen=True)
class _DiagnosisTask:
    path: Path
    name: str
    folder: Path
    seed: int
    threads: int
    keep: bool
    element: Element | None
    settings: "DiagnoseSettings"


def _diagnosed(
    tasks: list[_DiagnosisTask], executor: Executor, progress: Callable[[int, int], None] | None
) -> Iterator[Diagnosed | Failed]:
    told = None if progress is None else (lambda done: progress(done, len(tasks)))
    for outcome in in_order(executor.run(_diagnose_one, tasks), told):
        yield outcome if isinstance(outcome, Failed) else outcome.result


def _diagnose_one(task: _DiagnosisTask) -> Diagnosed:
    """Diagnose one experiment and write the result into its folder, unless a result of the same inputs is there."""
    begun = time.perf_counter()
    is_test = is_material_test(task.path)
    experiment = read_material_experiment(task.path) if is_test else read_experiment(task.path)
    file = task.path / "experiment.toml" if task.path.is_dir() else task.path
    mesh = "" if is_test else experiment.mesh.digest()  # type: ignore[union-attr]
    mark = _fingerprint([file, *sorted(experiment.folder.glob("*.csv"))], mesh, task)
    kept = _kept(task.folder, mark)
    if kept is not None:
        return Diagnosed(task.name, task.folder, kept, made=False)
    element = None if is_test else task.element
    made = diagnose(
        experiment, seed=task.seed, threads=task.threads, keep=task.keep, element=element, settings=task.settings
    )
    extra = {
        "threads": task.threads,
        "machine": machine(),
        "versions": versions(),
        "seconds": {"total": time.perf_counter() - begun},
        _MARK: mark,
    }
    made.save(task.folder, extra)
    return Diagnosed(task.name, task.folder, _answer(task.folder), made=True)


def _name(path: Path) -> str:
    """Return the name for an experiment's results: that of its folder, or of its file without ``.toml``."""
    return path.parent.name if path.name == "experiment.toml" else path.stem if path.suffix == ".toml" else path.name


def _fingerprint(files: list[Path], mesh: str, task: _DiagnosisTask) -> str:
    """Return a hash, hexadecimal, of an experiment's files, its mesh and the settings with which it is diagnosed."""
    contents = [[file.name, hashlib.sha256(file.read_bytes()).hexdigest()] for file in files]
    identity = json.dumps([contents, mesh, task.seed, task.element, repr(task.settings), __version__])
    return hashlib.sha256(identity.encode()).hexdigest()


def _kept(folder: Path, mark: str) -> dict[str, Any] | None:
    """Return the answer that lies in a folder, if it was made from inputs with this fingerprint; None otherwise."""
    try:
        answer = _answer(folder)
    except (OSError, ValueError):
        return None
    return answer if isinstance(answer, dict) and answer.get(_MARK) == mark else None


def _answer(folder: Path) -> Any:
    return json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
