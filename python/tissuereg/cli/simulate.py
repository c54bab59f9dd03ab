"""The command ``tissuereg simulate``: simulates all load cases of an experiment, or a data set for training."""

import argparse
import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.choices import ELEMENTS
from tissuereg._base.fields import choice, number
from tissuereg.cli.common import Outcome, Stopwatch, note, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting
from tissuereg.cli.progress import progress_bar
from tissuereg.parallel import TASK_LIMIT

if TYPE_CHECKING:
    from tissuereg.experiment.experiment import Experiment
    from tissuereg.simulation.experiment import CaseSimulation

HELP = Help(
    "PATH is an experiment (a folder, or its .toml): OUT becomes an experiment of the same rig whose markers.csv, "
    "forces.csv and targets.csv hold the believed model's predictions, without noise unless --noise is given, "
    "and case_NAME.npz with displacement_mm (frames, n, 3) at the nodes of the mesh. The model is the fine one that "
    "diagnose believes in (pads cut out along their rims, ten-node elements), or the mesh as it is with --plain; "
    "[simulated] in OUT's experiment.toml states which. Nothing need be measured: markers.csv and forces.csv may be "
    "missing. Or PATH is a data-set recipe (.toml): OUT gets the data set; "
    "run again, it goes on where it was stopped.",
    example="tissuereg simulate my-rig --out simulated",
    seed="seed of noise (default: 0), or of a data set (default: the recipe's)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg simulate`` to its parser."""
    parser.add_argument("path", metavar="PATH", help="experiment folder or file, or data-set recipe")
    parser.add_argument(
        "--out", required=True, metavar="OUT", help="folder for the results; of a recipe also a URL that fsspec knows"
    )
    how = parser.add_argument_group("experiment")
    how.add_argument("--plain", action="store_true", help="simulate on the mesh as it is, not with the fine model")
    usual = "tet4; a recipe states its own"
    add_option(how, "--element", choice(ELEMENTS, "elements of a plain simulation", default=None, otherwise=usual))
    how.add_argument("--noise", action="store_true", help="add the noise that the experiment states, by --seed")
    group = parser.add_argument_group("data set")
    text = (
        "make chunks on a Dask cluster: tcp://HOST:PORT, local:N (N processes here) or FILE.yaml (jobs of a batch "
        "system, see docs/cluster.md); a chunk then has one thread unless --threads says otherwise"
    )
    group.add_argument("--cluster", metavar="WHERE", help=text)
    text = "seconds after which a chunk counts as hung and is made elsewhere"
    add_option(group, "--chunk-limit", number(text, above=0.0, default=TASK_LIMIT), "S")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg simulate`` and write the result; JSON schema ``tissuereg.simulate/1``."""
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.experiments import is_experiment

    if not is_experiment(args.path):
        return _run_recipe(args)
    check_folder_target(args.out)
    return _run_experiment(args)


def _run_recipe(args: argparse.Namespace) -> Outcome:
    from tissuereg.parallel import open_executor
    from tissuereg.simulation.dataset import make_dataset, size_line
    from tissuereg.simulation.recipe import read_recipe

    for given, word in ((args.element is not None, "--element"), (args.plain, "--plain"), (args.noise, "--noise")):
        if given:
            refuse(f"{word} must be left out for a recipe, which states what is simulated", word)
    recipe = read_recipe(args.path)
    if not args.quiet:
        note(size_line(recipe, args.out))
    threads = args.threads if args.cluster is None else args.threads or 1
    with contextlib.ExitStack() as open_:
        executor = None
        if args.cluster is not None:
            executor = open_.enter_context(open_executor(args.cluster, task_limit=args.chunk_limit))
        progress = open_.enter_context(progress_bar("simulations", quiet=args.quiet))
        made = make_dataset(recipe, args.out, seed=args.seed, threads=threads, progress=progress, executor=executor)
    return _outcome({"schema": "tissuereg.simulate/1", **made}, args)


def _run_experiment(args: argparse.Namespace) -> Outcome:
    from tissuereg.experiment.experiment import Simulated
    from tissuereg.io.experiment_out import TABLES, write_simulated
    from tissuereg.io.experiments import read_experiment
    from tissuereg.simulation.believed import simulate_experiment
    from tissuereg.simulation.experiment import with_noise

    if args.cluster is not None:
        refuse("--cluster must be left out for an experiment; it makes the chunks of a data set", "--cluster")
    if args.element is not None and not args.plain:
        refuse("--element must come with --plain: the fine model has elements of its own", "--element")
    clock = Stopwatch()
    experiment = read_experiment(args.path, measured=False)
    refuse_overwriting([Path(args.out) / name for name in TABLES], _inputs(args.path, experiment))
    clock.lap("read")
    simulated = Simulated("plain", args.element or "tet4") if args.plain else Simulated("fine", "tet10")
    with progress_bar("frames", quiet=args.quiet) as progress:
        answers = simulate_experiment(
            experiment, model=simulated.model, element=simulated.element, threads=args.threads, progress=progress
        )
    spent = clock.lap("solve")
    if args.noise:
        answers = with_noise(experiment, answers, seed=args.seed or 0)
    write_simulated(Path(args.out), experiment, answers, simulated)
    clock.lap("write")
    failed = _failed(answers)
    n_frames = sum(len(answer.times) for answer in answers.values())
    content = {
        "schema": "tissuereg.simulate/1",
        "model": simulated.model,
        "element": simulated.element,
        "cases": {name: len(answer.times) for name, answer in answers.items()},
        "members": n_frames - len(failed),
        "failed": failed,
        "members_per_s": n_frames / spent,
        "seed": args.seed or 0,
        "seconds": clock.seconds,
    }
    return _outcome(content, args)


def _inputs(path: str, experiment: "Experiment") -> list[Path]:
    """Return the paths of the files from which an experiment is read, except that of the mesh."""
    from tissuereg.io.experiment_out import TABLES

    file = Path(path) / "experiment.toml" if Path(path).is_dir() else Path(path)
    return [file, *(experiment.folder / name for name in TABLES)]


def _failed(answers: "Mapping[str, CaseSimulation]") -> list[list[Any]]:
    """Return the frames without equilibrium: pairs of their number, counted through all load cases, and the reason."""
    failed, before = [], 0
    for name, answer in answers.items():
        failed += [[before + index, f"case '{name}': {reason}"] for index, reason in answer.failed]
        before += len(answer.times)
    return failed


def _outcome(content: dict[str, Any], args: argparse.Namespace) -> Outcome:
    rate = content["members_per_s"]
    lines = [
        f"{content['members']} simulations, {len(content['failed'])} without equilibrium"
        + ("" if rate is None else f", {rate:.3g} per second"),
        *(f"  failed: {index}: {reason}" for index, reason in content["failed"][:10]),
        *([_motion_line(content["motion"], content["bytes"])] if "motion" in content else []),
        *(
            []
            if content.get("overhead") is None
            else [f"{content['overhead']:.1%} of the workers' time went into no chunk"]
        ),
        seconds_line(content["seconds"], verbose=args.verbose),
        f"written: {args.out}",
    ]
    return Outcome(content, "\n".join(lines), args.threads)


def _motion_line(motion: dict[str, Any], n_bytes: int) -> str:
    """Return a line of text on how far deformations of a data set move the body, in mm, and on its size in bytes."""
    mean = motion["mean_node_mm"]
    line = (
        f"{n_bytes / 1e6:.{1 if n_bytes < 1e7 else 0}f} MB; a mean node moves {mean['mean']:.2f} mm (90 % of members "
        f"{mean['quantiles'][0]:.1f} to {mean['quantiles'][-1]:.1f}), at most {motion['largest_mm']['largest']:.1f} mm"
    )
    if motion["share_apart_7_mm"] is not None:
        line += f"; {motion['share_apart_7_mm']:.0%} of pairs lie 7 mm apart"
    return line
