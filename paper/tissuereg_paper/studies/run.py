"""The studies, run and written."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tissuereg import open_dataset
from tissuereg._base.arguments import called, check_choice, check_running, each, maybe, place
from tissuereg._base.clock import Clock
from tissuereg.errors import ArgumentError
from tissuereg.io.atomic import OutputError, atomic_folder, check_folder_target
from tissuereg.io.json import dumps
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.registration import as_model
from tissuereg_paper.studies.cases import draw_cases
from tissuereg_paper.studies.contest import KEYS, METHODS, Contest, Simulated
from tissuereg_paper.studies.figures import FIGURES, figure_study
from tissuereg_paper.studies.phantom import PHANTOM_STUDIES, phantom_study
from tissuereg_paper.studies.phantom_pages import phantom_csv, phantom_markdown, phantom_picture
from tissuereg_paper.studies.pictures import picture
from tissuereg_paper.studies.rigs import read_rigs
from tissuereg_paper.studies.study import Given, Study
from tissuereg_paper.studies.subject import Subject, subject_of
from tissuereg_paper.studies.table2 import table2_study
from tissuereg_paper.studies.tables import csv, markdown

#: The simulation studies, in the paper's order.
_STUDIES: dict[str, Study] = {"table2": table2_study, **{name: figure_study(name) for name in FIGURES}}

#: Their names, and those of all studies.
SIMULATED = tuple(_STUDIES)
STUDIES = (*SIMULATED, *PHANTOM_STUDIES)

#: Rigs of the phantom experiment in a checkout of the repository.
RIGS = Path("paper/bench/twin/rigs")

#: Most training fields that a method is given.
_MOST_FIELDS = 2000

SCHEMA = "tissuereg.reproduce/1"

#: Called with a study's name, and the number of lots that are done, and of all.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ContestInputs:
    """What the phantom experiment is given.

    Attributes
    ----------
    data : path-like, optional
        Rigs (``*.npz``); by default ``paper/bench/twin/rigs`` below the current folder.
    fields : path-like, optional
        Data set of the model's body, for methods that need training fields; without it they are left out.
    variants : path-like, optional
        Folder of variants of the rigs' simulations (``make -C paper variants``), for methods that need them; without
        it they are left out.
    methods : sequence of str, optional
        Methods, by their names in tables or their short ones in JSON; by default all.
    keep : path-like, optional
        Folder where what each method did on each rig is kept, so that a run that was stopped goes on.

    Raises
    ------
    ArgumentError
        If a method is unknown, or a folder is no path.
    """

    data: str | os.PathLike[str] | None = None
    fields: str | os.PathLike[str] | None = None
    variants: str | os.PathLike[str] | None = None
    methods: Sequence[str] | None = None
    keep: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        for name in ("data", "fields", "variants", "keep"):
            if getattr(self, name) is not None:
                place(name, getattr(self, name))
        if self.methods is not None:
            names_of = {key: name for name, key in KEYS.items()}
            chosen = tuple(names_of.get(name, name) for name in each("methods", self.methods, str))
            for method in chosen:
                check_choice("methods", method, METHODS, ArgumentError)
            object.__setattr__(self, "methods", chosen)


@dataclass(frozen=True)
class Running:
    """How studies are run: seed, threads, the clock of their stages, and whom progress is told.

    Attributes
    ----------
    seed, threads : int
    progress : callable of (str, int, int), optional
        Called with a study's name, and the number of lots that are done, and of all.
    clock : Clock
    """

    seed: int = 0
    threads: int = 0
    progress: Progress | None = None
    clock: Clock = field(default_factory=Clock)

    def told(self, name: str) -> Callable[[int, int], None] | None:
        """Return whom the progress of a study is told."""
        progress = self.progress
        return None if progress is None else lambda done, in_all: progress(name, done, in_all)


def reproduce(
    studies: str | Sequence[str],
    out: str | os.PathLike[str],
    *,
    model: str | os.PathLike[str] | None = None,
    contest: ContestInputs | None = None,
    seed: int = 0,
    threads: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run studies of the paper (simulations of section III, phantom of section IV), and write tables and pictures.

    Parameters
    ----------
    studies : str or sequence of str
        Among ``table2``, ``fig6``, ``fig7``, ``fig8``, and of the phantom experiment ``fig10``, ``fig11``, ``phantom``.
    out : path-like
        Folder for ``NAME.md``, ``NAME.csv``, ``NAME.png`` and ``NAME.json`` of every study, written together.
    model : path-like, optional
        Folder of a trained model of a body whose recipe travels with the package; by default the shipped model. The
        phantom experiment takes one of ``phantom_mesh()``.
    contest : ContestInputs, optional
        Of the phantom experiment.
    seed : int
        Of the choice of shapes, markers and inner points, of the tracker's noise, and of the ensembles.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    progress : callable of (str, int, int), optional
        Called with a study's name, and the number of lots of pairs, or of rigs under a condition, that are done, and
        of all.

    Returns
    -------
    dict
        ``rows`` and ``agree`` of all studies, ``model``, ``methods``, ``cases``; of ``table2`` also ``layers`` and
        ``samples``, of ``fig8`` ``goal``. `paper/pages/paper.md` explains them, and `phantom-experiment.md` there
        those of the phantom.

    Raises
    ------
    ArgumentError
        If a study is unknown, or there is no rig of a figure's scenario.
    FormatError
        If a rig or the data set cannot be read.
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
    inputs = maybe("contest", contest, ContestInputs) or ContestInputs()
    folder = place("out", out, error=OutputError)
    check_folder_target(folder)
    running = Running(seed, threads, progress)
    contents: dict[str, dict[str, Any]] = {}
    simulated = [name for name in dict.fromkeys(names) if name in SIMULATED]
    phantom = [name for name in dict.fromkeys(names) if name in PHANTOM_STUDIES]
    if phantom:
        with running.clock.stage("rigs"):
            rivals = _contest(inputs, model, running)
    if simulated:
        with running.clock.stage("model"):
            subject = subject_of(model)
        contents |= _simulated(simulated, subject, running)
    if phantom:
        contents |= run_contest(phantom, rivals, running)
    return _delivered(folder, contents, running.clock)


def run_contest(names: Sequence[str], contest: Contest, running: Running) -> dict[str, dict[str, Any]]:
    """Return the JSON of phantom studies by name."""
    contents = {}
    with threadpool_limits(limits=1, user_api="blas"):
        for name in names:
            with running.clock.stage(name):
                found = phantom_study(name, contest, running.told(name))
                contents[name] = {"schema": SCHEMA, "seed": running.seed, "model": contest.facts, **found}
    return contents


def _contest(inputs: ContestInputs, model: Any, running: Running) -> Contest:
    rigs = read_rigs(RIGS if inputs.data is None else inputs.data)
    mesh = phantom_mesh()
    known = as_model("phantom" if model is None else model, mesh, running.threads)
    trained = None
    if inputs.fields is not None:
        dataset = open_dataset(inputs.fields)
        members = dataset.split["train"]
        members = members[np.sort(np.random.default_rng(running.seed).permutation(len(members))[:_MOST_FIELDS])]
        trained = np.asarray(dataset.displacement[members], np.float64)
    wanted = METHODS if inputs.methods is None else {name: METHODS[name] for name in (Simulated.name, *inputs.methods)}
    return Contest(
        rigs,
        mesh,
        known,
        trained,
        inputs.variants,
        methods=wanted,
        seed=running.seed,
        threads=running.threads,
        keep=inputs.keep,
    )


def _simulated(names: Sequence[str], subject: Subject, running: Running) -> dict[str, dict[str, Any]]:
    seed, threads = running.seed, running.threads
    with running.clock.stage("shapes"):
        cases = draw_cases(subject.held_out, seed, threads)
    contents = {}
    # One pool of threads at a time: lots of pairs run side by side.
    with threadpool_limits(limits=1, user_api="blas"):
        for name in names:
            with running.clock.stage(name):
                found = _STUDIES[name](Given(subject, cases, seed, threads, running.told(name)))
                contents[name] = {"schema": SCHEMA, "seed": seed, "model": subject.facts, **found}
    return contents


def _delivered(out: Path, contents: dict[str, dict[str, Any]], clock: Clock) -> dict[str, Any]:
    """Write the studies, and return them as one answer."""
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
            of_phantom = name in PHANTOM_STUDIES
            page = phantom_markdown(content) if of_phantom else markdown(content)
            table = phantom_csv(content) if of_phantom else csv(content)
            figure = phantom_picture(content) if of_phantom else picture(content)
            (draft / f"{name}.md").write_text(page, encoding="utf-8")
            (draft / f"{name}.csv").write_text(table, encoding="utf-8")
            figure.savefig(draft / f"{name}.png", dpi=110)
