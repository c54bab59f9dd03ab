"""The studies, run and written."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tissuereg._arguments import called, check_running, each, place
from tissuereg._choice import check_choice
from tissuereg._clock import Clock
from tissuereg.errors import ArgumentError
from tissuereg.io.atomic import OutputError, atomic_folder, check_folder_target
from tissuereg.io.json import dumps
from tissuereg.studies.cases import N_STARTS, N_TARGETS, draw_cases
from tissuereg.studies.figures import FIGURES, figure_study
from tissuereg.studies.pictures import picture
from tissuereg.studies.study import Given, Study
from tissuereg.studies.subject import Subject, subject_of
from tissuereg.studies.table2 import table2_study
from tissuereg.studies.tables import csv, markdown

#: The studies, in the paper's order.
_STUDIES: dict[str, Study] = {"table2": table2_study, **{name: figure_study(name) for name in FIGURES}}

#: Their names.
STUDIES = tuple(_STUDIES)

SCHEMA = "tissuereg.reproduce/1"

#: Called with a study's name, and the number of lots that are done, and of all.
Progress = Callable[[str, int, int], None]


def reproduce(
    studies: str | Sequence[str],
    out: str | os.PathLike[str],
    *,
    model: str | os.PathLike[str] | None = None,
    seed: int = 0,
    threads: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run simulation studies of the paper (section III), and write tables and pictures.

    Parameters
    ----------
    studies : str or sequence of str
        Among ``table2``, ``fig6``, ``fig7``, ``fig8``.
    out : path-like
        Folder for ``NAME.md``, ``NAME.csv``, ``NAME.png`` and ``NAME.json`` of every study, written together.
    model : path-like, optional
        Folder of a trained model of a body whose recipe travels with the package; by default the shipped model.
    seed : int
        Of the choice of shapes, markers and inner points, and of the ensembles.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    progress : callable of (str, int, int), optional
        Called with a study's name, and the number of lots of pairs that are done, and of all.

    Returns
    -------
    dict
        ``rows`` and ``agree`` of all studies, ``model``, ``methods``, ``cases``; of ``table2`` also ``layers`` and
        ``samples``, of ``fig8`` ``goal``. `docs/paper.md` explains them.

    Raises
    ------
    ArgumentError
        If a study is unknown.
    ModelError
        If the model cannot be read, or its body is not known.
    EnsembleError
        If a shape has no equilibrium.
    OutputError
        If `out` cannot be written.

    Notes
    -----
    Test shapes are solved anew from the recipe of the model's data set; no data set is needed. M. Afshar et al.,
    "Registration of deformed tissue: a GNN-VAE approach with data assimilation for sim-to-real transfer".
    """
    names = [studies] if isinstance(studies, str) else list(each("studies", studies, str))
    for name in names:
        check_choice("studies", name, STUDIES, ArgumentError)
    if not names:
        message = f"`studies` must name at least one of {', '.join(STUDIES)}, got none"
        raise ArgumentError(message, where="studies")
    check_running(seed=seed, threads=threads)
    called("progress", progress)
    folder = place("out", out, error=OutputError)
    check_folder_target(folder)
    clock = Clock()
    with clock.stage("model"):
        subject = subject_of(model)
    return run_studies(
        list(dict.fromkeys(names)), subject, folder, seed=seed, threads=threads, clock=clock, progress=progress
    )


def run_studies(
    names: Sequence[str],
    subject: Subject,
    out: Path,
    *,
    seed: int = 0,
    threads: int = 0,
    clock: Clock | None = None,
    progress: Progress | None = None,
    n_starts: int = N_STARTS,
    n_targets: int = N_TARGETS,
) -> dict[str, Any]:
    """Run studies of any subject, of any number of pairs; `reproduce` has the other arguments and the answer."""
    clock = clock or Clock()
    with clock.stage("shapes"):
        cases = draw_cases(subject.held_out, seed, threads, n_starts=n_starts, n_targets=n_targets)
    contents = {}
    # One pool of threads at a time: lots of pairs run side by side.
    with threadpool_limits(limits=1, user_api="blas"):
        for name in names:
            with clock.stage(name):
                tell = None if progress is None else _told(progress, name)
                found = _STUDIES[name](Given(subject, cases, seed, threads, tell))
                contents[name] = {"schema": SCHEMA, "seed": seed, "model": subject.facts, **found}
    with clock.stage("files"):
        _write(out, contents)
    answer: dict[str, Any] = {"rows": [], "agree": {}}
    for content in contents.values():
        rows, agree = answer["rows"] + content["rows"], answer["agree"] | content["agree"]
        answer = {**answer, **content, "rows": rows, "agree": agree}
    return {**answer, "seconds": {**clock.seconds, "total": sum(clock.seconds.values())}}


def _write(out: Path, contents: dict[str, dict[str, Any]]) -> None:
    with atomic_folder(out) as draft:
        for name, content in contents.items():
            (draft / f"{name}.json").write_text(dumps(content), encoding="utf-8")
            (draft / f"{name}.md").write_text(markdown(content), encoding="utf-8")
            (draft / f"{name}.csv").write_text(csv(content), encoding="utf-8")
            picture(content).savefig(draft / f"{name}.png", dpi=110)


def _told(progress: Progress, name: str) -> Callable[[int, int], None]:
    return lambda done, in_all: progress(name, done, in_all)
