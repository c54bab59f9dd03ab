"""The constants of the compared methods, on rigs that are not reported -> archive/rivals-tuning, its page.

    python -m scripts.tune_rivals [--data RIGS] [--fields DATA] [--variants FOLDER] [--keep FOLDER]
        [--only WORD] [--add WORD] [--kept] [--page]

Every constant is varied by itself, the others at their defaults; a default is right when it is the best of its own
sweep. After a change of a default the command is run again: what was run before with the same constants is kept.
``--only`` runs the sweeps of methods whose name holds the word and writes neither archive nor page, so that several
processes share the work; ``--add`` runs those and lets them take the place of what the archive has of these methods;
``--kept`` writes archive and page of what was run so far, ``--page`` the page alone.
"""

import argparse
import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import read_archive, write_archive
from threadpoolctl import threadpool_limits

import tissuereg as tr
from scripts.tune_rivals_page import page
from tissuereg.io.fields import write_npz
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.registration import as_model
from tissuereg_paper import rivals as b
from tissuereg_paper.rivals import Rival
from tissuereg_paper.studies.believed import PLAIN, Believed, measured
from tissuereg_paper.studies.believed import Path as BelievedPath
from tissuereg_paper.studies.contest import METHODS, Simulated, run_method
from tissuereg_paper.studies.rigs import Rig, read_rigs
from tissuereg_paper.studies.variants import read_variants

PAPER = Path(__file__).resolve().parents[2]
ARCHIVE, PAGE = PAPER / "archive" / "rivals-tuning", PAPER / "pages" / "rivals-tuning.md"

#: What of the archive are tables.
TABLES = ("sweeps/#", "methods/#")

#: Training fields for principal components.
N_FIELDS = 2000

#: Frames of the last push.
N_LAST = 80


@dataclass(frozen=True)
class Sweep:
    """One constant of a method, varied by itself.

    Attributes
    ----------
    method : type of Rival
    constant : str
        A keyword of its constructor.
    values : tuple
    seeds : int
        Rigs of each scenario.
    last : bool
        Whether the last push alone is run: all of its frames where the method remembers, otherwise those scored.
    others : mapping of str to object
        Other constants that are not at their defaults.
    """

    method: type[Rival]
    constant: str
    values: tuple[Any, ...]
    seeds: int = 6
    last: bool = False
    others: Mapping[str, Any] = field(default_factory=dict)


#: Rounds of PBD in the sweeps of what makes it converge in fewer.
ROUNDS = {"n_iterations": 30}

SWEEPS = (
    Sweep(b.Spline, "smoothing", (0.0, 1e4, 1e5, 1e6)),
    Sweep(b.SplineAbout, "smoothing", (0.0, 1e4, 1e5, 1e6)),
    Sweep(b.LinearElastic, "smooth", (False, True)),
    Sweep(b.LinearElastic, "rigid", (0.0, 0.3, 1.0, 3.0)),
    Sweep(b.Libr, "n_cells", (15, 30, 45, 90)),
    Sweep(b.Libr, "energy_weight", (None, 0.001, 0.01, 0.1, 1.0)),
    Sweep(b.Libr, "rigid", (0.0, 0.3, 1.0, 3.0)),
    Sweep(b.LinearResidual, "memory_s", (0.025, 0.25, 1.0), seeds=2),
    Sweep(b.LinearResidual, "window", (10, 30, 60), seeds=2),
    Sweep(b.PositionBasedDynamics, "energy_uj", (3.0, 30.0, 300.0), seeds=1, last=True),
    Sweep(b.PositionBasedDynamics, "n_iterations", (30, 100, 300), seeds=1, last=True),
    Sweep(b.PositionBasedDynamics, "density_g_cm3", (10.0, 30.0, 100.0), seeds=1, last=True, others=ROUNDS),
    Sweep(b.PositionBasedDynamics, "momentum", (0.0, 0.9, 0.95), seeds=1, last=True, others=ROUNDS),
    Sweep(b.KfAdmm, "carried", (0.0, 0.5, 1.0), seeds=1),
    Sweep(b.KfAdmm, "modes", ("admm", "elastic"), seeds=1),
    Sweep(b.KfAdmm, "noise_mm", (0.1, 0.3, 1.0), seeds=1),
    Sweep(b.KfAdmm, "n_iterations", (3, 5, 10, 20), seeds=1),
    Sweep(b.KfAdmm, "density_g_cm3", (0.1, 1.0, 10.0), seeds=1),
    Sweep(b.KfAdmm, "n_modes", (75, 150, 300), seeds=1),
    Sweep(b.ParameterInference, "load_std", (0.1, 0.3, 0.6), seeds=1, last=True),
    Sweep(b.ParameterInference, "n_members", (4, 8), seeds=1, last=True),
    Sweep(b.ParameterInference, "later_steps", (1, 2), seeds=1, last=True),
    Sweep(b.PcaEsMda, "n_latent", (10, 26, 52, 100), seeds=3),
    Sweep(b.OneStepSmoother, "n_members", (50, 100, 200), seeds=3),
    Sweep(b.LatentFilter, "memory_s", (0.01, 0.1, 0.3), seeds=2),
    Sweep(b.LatentFilter, "n_members", (50, 100, 200), seeds=2),
    Sweep(b.EnsembleOfSimulations, "error_mm", (0.0, 0.05, 0.1, 0.2, 0.4), seeds=4),
)

#: Not in the table of all methods: takes seconds a frame, and has no constant.
LEFT_OUT = (b.PhysicsPrior,)

#: Rigs of each scenario in the table of all methods, where it is not all of them.
FEWER = {
    b.ParameterInference: 1,
    b.KfAdmm: 1,
    b.PositionBasedDynamics: 1,
    b.LatentFilter: 2,
    b.EnsembleOfSimulations: 4,
    b.VariedNetwork: 4,
}


def constants_of(method: type[Rival]) -> dict[str, Any]:
    """Return the constants of a method by name, with their defaults."""
    parameters = inspect.signature(method).parameters.values()
    return {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY and one.name != "settings"}


class Bench:
    """Rigs with what is believed of them, and runs that are kept.

    Parameters
    ----------
    rigs : list of Rig
    keep : path-like
        Folder of believed fields and of runs.
    fields : path-like, optional
        Data set of training fields.
    variants : path-like, optional
        Folder of variants of the rigs' simulations.
    kept_only : bool
        Whether nothing is run: what was not kept raises `LookupError`.
    """

    def __init__(
        self,
        rigs: Iterable[Rig],
        keep: Path,
        fields: Path | None,
        variants: Path | None = None,
        kept_only: bool = False,
    ) -> None:
        self.rigs, self._keep, self._fields, self._variants = list(rigs), keep, fields, variants
        self._kept_only = kept_only
        self._mesh = phantom_mesh()
        self._model: Any = None
        self._trained: Any = None
        self._believed: dict[tuple[str, bool], Believed] = {}
        keep.mkdir(parents=True, exist_ok=True)

    def chosen(self, seeds: int) -> list[Rig]:
        """Return so many rigs of each scenario."""
        scenarios = sorted({rig.scenario for rig in self.rigs})
        return [rig for one in scenarios for rig in [r for r in self.rigs if r.scenario == one][:seeds]]

    def run(self, method: type[Rival], constants: Mapping[str, Any], rig: Rig, last: bool) -> dict[str, Any]:
        """Return what a method does on a rig with these constants; kept."""
        known = {**constants_of(method), **constants}
        facts = {"method": method.name, "constants": known, "rig": rig.name, "last": last}
        digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]
        path = self._keep / f"run-{digest}.json"
        if path.exists():
            return dict(json.loads(path.read_text(encoding="utf-8")))
        if self._kept_only:
            raise LookupError(path)
        believed = self._of(rig, last)
        fields = self._training_fields() if "fields" in method.needs else None
        setting = believed.setting(PLAIN, self._latent_model(method), fields, 0)
        run = run_method(
            method(setting, **constants),
            believed,
            measured(believed.rig, PLAIN, 0),
            PLAIN,
            scored_alone=not method.remembers,
        )
        errors = {"sensor_mm": float(run.sensor_mm.mean()), "inner_mm": float(run.inner_mm.mean())}
        found = {**facts, **errors, "frames": run.frames, "failed": run.failed}
        path.write_text(json.dumps(found), encoding="utf-8")
        print(json.dumps(found), file=sys.stderr, flush=True)
        return found

    def sweep(self, one: Sweep) -> dict[str, Any]:
        """Return the runs of a sweep."""
        rigs = self.chosen(one.seeds)
        runs = [
            [self.run(one.method, {**one.others, one.constant: value}, rig, one.last) for rig in rigs]
            for value in one.values
        ]
        return {
            "method": one.method.name,
            "constant": one.constant,
            "default": constants_of(one.method)[one.constant],
            "values": list(one.values),
            "others": dict(one.others),
            "rigs": [rig.name for rig in rigs],
            "last": one.last,
            "failed": [sum(run["failed"] for run in of_value) for of_value in runs],
            **{part: [[run[part] for run in of_value] for of_value in runs] for part in ("sensor_mm", "inner_mm")},
        }

    def row(self, method: type[Rival]) -> dict[str, Any]:
        """Return the errors of a method with its defaults, and of the simulation on the same rigs."""
        rigs = self.chosen(FEWER.get(method, len(self.rigs)))
        runs = [self.run(method, {}, rig, False) for rig in rigs]
        plain = [self.run(Simulated, {}, rig, False) for rig in rigs]
        parts = ("sensor_mm", "inner_mm")
        return {
            "method": method.name,
            "rigs": [rig.name for rig in rigs],
            "failed": sum(run["failed"] for run in runs),
            **{part: [run[part] for run in runs] for part in parts},
            **{f"simulation_{part}": [run[part] for run in plain] for part in parts},
        }

    def _of(self, rig: Rig, last: bool) -> Believed:
        key = rig.name, last
        if key not in self._believed:
            cut = replace(rig, motion=rig.motion[-N_LAST:]) if last else rig
            known = None
            if self._variants is not None and (self._variants / f"{rig.name}.npz").exists():
                known = read_variants(self._variants, rig, self._mesh.n_nodes)
            believed, path = Believed(cut, self._mesh, 1, known), self._keep / f"path-{rig.name}.npz"
            if path.exists():
                with np.load(path) as file:
                    kept = BelievedPath(file["shares"], file["fields_mm"], file["pushes"])
                believed.__dict__["path"] = kept
            else:
                kept = believed.path
                write_npz(path, {"shares": kept.shares, "fields_mm": kept.fields_mm, "pushes": kept.pushes})
            self._believed[key] = believed
        return self._believed[key]

    def _latent_model(self, method: type[Rival]) -> Any:
        if "model" not in method.needs:
            return None
        self._model = self._model or as_model("phantom", self._mesh, 1)
        return self._model

    def _training_fields(self) -> Any:
        if self._trained is None:
            dataset = tr.open_dataset(self._fields)
            members = dataset.split["train"]
            members = members[np.sort(np.random.default_rng(0).permutation(len(members))[:N_FIELDS])]
            self._trained = np.asarray(dataset.displacement[members], np.float64)
        return self._trained


def gathered(bench: Bench, methods: list[type[Rival]]) -> dict[str, Any]:
    """Return sweeps and rows of methods, and what is still to be run."""
    found: dict[str, Any] = {"sweeps": [], "methods": [], "pending": []}

    def add(part: str, words: list[str], made: Callable[[], dict[str, Any]]) -> None:
        try:
            found[part].append(made())
        except LookupError:
            found["pending"].append(words)

    for one in [one for one in SWEEPS if one.method in methods]:
        add("sweeps", [one.method.name, one.constant], partial(bench.sweep, one))
    for method in [method for method in methods if method not in LEFT_OUT]:
        add("methods", [method.name, "all defaults"], partial(bench.row, method))
    return found


def methods_of(word: str, without: set[str]) -> list[type[Rival]]:
    """Return the methods whose name holds a word and that need nothing that is not given."""
    return [one for one in METHODS.values() if word in one.name and not one.needs & without]


def added(archive: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Return an archive in which what was found takes the place of what it had of the same sweeps and methods."""
    parts = {}
    for part in ("sweeps", "methods"):
        new = {_words(one) for one in found[part]}
        parts[part] = [one for one in archive[part] if _words(one) not in new] + found[part]
    known = {_words(one) for part in parts.values() for one in part}
    pending = [words for words in [*archive["pending"], *found["pending"]] if tuple(words) not in known]
    return {**archive, **parts, "pending": pending}


def _words(one: Mapping[str, Any]) -> tuple[str, str]:
    """Return what a sweep or a row of the archive is of."""
    return one["method"], one.get("constant", "all defaults")


def main() -> None:
    """Run the sweeps, or write the page again."""
    parser = argparse.ArgumentParser(description="Tune the compared methods.")
    parser.add_argument("--data", type=Path, default=PAPER / "bench" / "twin" / "development")
    parser.add_argument("--fields", type=Path)
    parser.add_argument("--variants", type=Path)
    parser.add_argument("--keep", type=Path, default=PAPER.parent / "build" / "rivals-tuning")
    parser.add_argument("--only", default="")
    parser.add_argument("--add", default="", help="methods whose sweeps take the place of the archive's")
    parser.add_argument("--kept", action="store_true", help="archive and page of what is kept; run nothing")
    parser.add_argument("--page", action="store_true", help="write the page again from the archive")
    given = parser.parse_args()
    if not given.page:
        bench = Bench(read_rigs(given.data), given.keep, given.fields, given.variants, given.kept)
        without = {name for name in ("fields", "variants") if getattr(given, name) is None}
        methods = methods_of(given.only or given.add, without)
        with threadpool_limits(limits=1, user_api="blas"):
            found = gathered(bench, methods)
        if given.only:
            return
        if given.add:
            answer = added(read_archive(ARCHIVE), found)
        else:
            answer = {
                "schema": "tissuereg.rivals-tuning/1",
                "rigs": [rig.name for rig in bench.rigs],
                "training_fields": 0 if given.fields is None else N_FIELDS,
                **found,
            }
        write_archive(ARCHIVE, answer, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
