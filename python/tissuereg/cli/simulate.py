"""``tissuereg simulate``: all cases of an experiment, or a data set for training."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg.cli.common import Outcome, Stopwatch, progress_bar, seconds_line
from tissuereg.cli.options import UsageError, add_common, command_parser, refuse_overwriting

if TYPE_CHECKING:
    from tissuereg.experiment import Experiment
    from tissuereg.simulate.experiment import CaseSimulation

_DETAILS = (
    "PATH is an experiment (a folder, or its .toml): OUT gets what the believed model says of every frame, as "
    "markers.csv, forces.csv, targets.csv in the experiment's own format and case_NAME.npz with displacement_mm "
    "(frames, n, 3). Or PATH is a data-set recipe (.toml): OUT gets the data set; run again, it goes on where it "
    "was stopped."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "simulate an experiment, or a data set to train on"
    parser = command_parser(commands, "simulate", purpose, _DETAILS, "tissuereg simulate my-rig --out simulated")
    parser.add_argument("path", metavar="PATH", help="experiment folder or file, or data-set recipe")
    parser.add_argument("--out", required=True, metavar="OUT", help="folder for the results")
    how = parser.add_argument_group("experiment")
    text = "nodes a tet (default: tet4; a recipe states its own)"
    how.add_argument("--element", choices=["tet4", "tet4-averaged", "tet10"], help=text)
    add_common(parser, seed="seed of a data set (default: the recipe's, which is 0 unless it says so)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Simulate and write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.simulate/1``.
    """
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.experiments import is_experiment

    check_folder_target(args.out)
    return _run_experiment(args) if is_experiment(args.path) else _run_recipe(args)


def _run_recipe(args: argparse.Namespace) -> Outcome:
    from tissuereg.simulate.dataset import make_dataset
    from tissuereg.simulate.recipe import read_recipe

    if args.element is not None:
        message = "--element must be left out for a recipe, which states its own"
        raise UsageError(message, where="--element")
    recipe = read_recipe(args.path)
    with progress_bar("simulations", quiet=args.quiet) as progress:
        made = make_dataset(recipe, args.out, seed=args.seed, threads=args.threads, progress=progress)
    return _outcome({"schema": "tissuereg.simulate/1", **made}, args)


def _run_experiment(args: argparse.Namespace) -> Outcome:
    from tissuereg.io.experiments import read_experiment
    from tissuereg.simulate.experiment import simulate_experiment

    clock = Stopwatch()
    experiment = read_experiment(args.path)
    tables = ("markers.csv", "forces.csv", "targets.csv")
    refuse_overwriting([Path(args.out) / name for name in tables], [experiment.folder / name for name in tables])
    clock.lap("read")
    element = args.element or "tet4"
    with progress_bar("frames", quiet=args.quiet) as progress:
        answers = simulate_experiment(experiment, element=element, threads=args.threads, progress=progress)
    spent = clock.lap("solve")
    _write(Path(args.out), experiment, answers)
    clock.lap("write")
    failed = _failed(answers)
    n_frames = sum(len(answer.times) for answer in answers.values())
    content = {
        "schema": "tissuereg.simulate/1",
        "cases": {name: len(answer.times) for name, answer in answers.items()},
        "members": n_frames - len(failed),
        "failed": failed,
        "members_per_s": n_frames / spent,
        "seed": args.seed or 0,
        "seconds": clock.seconds,
    }
    return _outcome(content, args)


def _failed(answers: "Mapping[str, CaseSimulation]") -> list[list[Any]]:
    """Return frames without equilibrium, counted through all cases, each with its reason."""
    failed, before = [], 0
    for name, answer in answers.items():
        failed += [[before + index, f"case '{name}': {reason}"] for index, reason in answer.failed]
        before += len(answer.times)
    return failed


def _write(out: Path, experiment: "Experiment", answers: "Mapping[str, CaseSimulation]") -> None:
    from tissuereg.io.atomic import atomic_folder
    from tissuereg.io.cases import write_histories
    from tissuereg.io.npz import write_npz

    with atomic_folder(out) as folder:
        names = experiment.marker_names
        markers = {c: (a.times, {n: a.markers[:, i] for i, n in enumerate(names)}) for c, a in answers.items()}
        write_histories(folder / "markers.csv", "marker", "mm", markers)
        forces = {case: (answer.times, answer.forces) for case, answer in answers.items() if answer.forces}
        if forces:
            write_histories(folder / "forces.csv", "actuator", "mN", forces)
        targets = {case: (answer.times, answer.targets) for case, answer in answers.items() if answer.targets}
        if targets:
            write_histories(folder / "targets.csv", "target", "mm", targets)
        for number, (case, answer) in enumerate(answers.items()):
            arrays = {"time_s": answer.times, "displacement_mm": answer.displacement}
            write_npz(folder / f"case_{_file_word(case, number)}.npz", arrays)


def _file_word(case: str, number: int) -> str:
    plain = all(letter.isalnum() or letter in "-_" for letter in case)
    return case if plain else str(number)


def _outcome(content: dict[str, Any], args: argparse.Namespace) -> Outcome:
    rate = content["members_per_s"]
    lines = [
        f"{content['members']} simulations, {len(content['failed'])} without equilibrium"
        + ("" if rate is None else f", {rate:.3g} a second"),
        *(f"  failed: {index}: {reason}" for index, reason in content["failed"][:10]),
        seconds_line(content["seconds"]),
        f"written: {args.out}",
    ]
    return Outcome(content, "\n".join(lines), args.threads)
