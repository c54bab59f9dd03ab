"""``tissuereg diagnose``: what the simulation of an experiment gets wrong, and why."""

import argparse
import sys
from typing import Any

from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import add_common, command_parser

_DETAILS = (
    "EXPERIMENT is a folder (or its .toml). OUT gets diagnosis.json, experiment.extended.toml (the believed experiment "
    "with the findings as effects; simulate, register and diagnose read it) and report.html."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "find out what the simulation gets wrong"
    parser = command_parser(commands, "diagnose", purpose, _DETAILS, "tissuereg diagnose my-rig --out diagnosed")
    parser.add_argument("experiment", metavar="EXPERIMENT", help="experiment folder or file")
    parser.add_argument("--out", metavar="OUT", help="folder for the results")
    text = "elements of the believed model of a body (default: tet4)"
    parser.add_argument("--element", choices=["tet4", "tet4-averaged", "tet10"], default="tet4", help=text)
    parser.add_argument("--no-cache", action="store_true", help="make the bank of causes anew, keep nothing")
    add_common(parser, seed="seed of all chance (default: 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Diagnose and write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.diagnosis/1``.
    """
    from tissuereg.diagnose import diagnose
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.experiments import is_material_test, read_experiment
    from tissuereg.io.material_experiments import read_material_experiment

    if args.out is not None:
        check_folder_target(args.out)
    clock = Stopwatch()

    def told(stage: str) -> None:
        if not args.quiet:
            print(f"diagnose: {stage}", file=sys.stderr, flush=True)

    settings: dict[str, Any] = {
        "seed": args.seed or 0,
        "threads": args.threads,
        "keep": not args.no_cache,
        "element": args.element,
    }
    read = read_material_experiment if is_material_test(args.experiment) else read_experiment
    experiment = read(args.experiment)
    clock.lap("read")
    found = diagnose(experiment, progress=told, **settings)
    clock.lap("diagnose")
    if args.out is not None:
        found.save(args.out)
        clock.lap("write")
    return _outcome(found.to_json(), clock, args)


def _outcome(answer: dict[str, Any], clock: Stopwatch, args: argparse.Namespace) -> Outcome:
    provisional = ", provisional" if answer.get("provisional") else ""
    lines = [f"{answer['verdict']}{provisional} (p_misfit {answer['p_misfit']:.2g})"]
    for cause in answer["causes"]:
        tied = f" (or {', '.join(cause['group'][1:])})" if len(cause["group"]) > 1 else ""
        lines.append(f"  {cause['id']}{tied}, P = {cause['probability']:.2f}: {cause['sentence']}")
    if answer.get("next_experiment"):
        lines.append(f"  next: {answer['next_experiment']['action']}")
    lines.append(seconds_line(clock.seconds))
    if args.out is not None:
        lines.append(f"written: {args.out}")
    return Outcome({**answer, "seconds": clock.seconds}, "\n".join(lines), args.threads)
