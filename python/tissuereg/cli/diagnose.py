"""The command ``tissuereg diagnose``: finds out what the simulation of an experiment gets wrong, and why."""

import argparse
import sys
from pathlib import Path
from typing import Any

from tissuereg._base.choices import ELEMENTS
from tissuereg._base.fields import choice
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, envelope, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting

HELP = Help(
    "EXPERIMENT is a folder (or its .toml). OUT gets diagnosis.json, experiment.extended.toml (the believed experiment "
    "with its modulus as fitted and the findings as effects; simulate, register and diagnose read it; that of a "
    "material test is for diagnose alone) and report.html. The bank of causes is kept for the next experiment of a "
    "mesh and rig.",
    example="tissuereg diagnose my-rig --out diagnosed",
    seed="seed of all random numbers (default: 0)",
)

_WRITTEN = ("diagnosis.json", "experiment.extended.toml", "report.html")


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg diagnose`` to its parser."""
    parser.add_argument("experiment", metavar="EXPERIMENT", help="experiment folder or file")
    parser.add_argument("--out", metavar="OUT", help="folder for the results; without it nothing is written")
    elements = choice(ELEMENTS, "elements of the believed model of a body", default=None, otherwise="tet4")
    add_option(parser, "--element", elements)
    parser.add_argument(
        "--exit-code", action="store_true", help="end with 4 for any verdict but `consistent` (otherwise with 0)"
    )
    parser.add_argument("--no-cache", action="store_true", help="make the bank of causes anew, keep nothing")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg diagnose``: diagnose an experiment, write the answer; JSON schema ``tissuereg.diagnosis/1``."""
    from tissuereg.diagnosis import diagnose
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.experiments import is_material_test, read_experiment
    from tissuereg.io.material_experiments import read_material_experiment

    if args.out is not None:
        given = Path(args.experiment)
        inputs = [given / "experiment.toml" if given.is_dir() else given]
        refuse_overwriting([Path(args.out) / name for name in _WRITTEN], inputs)
        check_folder_target(args.out)
    clock = Stopwatch()

    def show(stage: str) -> None:
        if not args.quiet:
            print(f"diagnose: {stage}", file=sys.stderr, flush=True)

    settings: dict[str, Any] = {
        "seed": args.seed or 0,
        "threads": args.threads,
        "keep": not args.no_cache,
        "element": args.element or "tet4",
    }
    is_test = is_material_test(args.experiment)
    if is_test and args.element is not None:
        refuse("--element must be left out for a material test, which has no elements", "--element")
    experiment = read_material_experiment(args.experiment) if is_test else read_experiment(args.experiment)
    clock.lap("read")
    found = diagnose(experiment, progress=show, **settings)
    clock.lap("diagnose")
    answer = found.to_json()
    if args.out is None:
        answer["extended_model"] = None
    else:
        found.save(args.out, {**envelope(args.threads), "seconds": clock.seconds})
        clock.lap("write")
    return _outcome(answer, clock, args)


def _outcome(answer: dict[str, Any], clock: Stopwatch, args: argparse.Namespace) -> Outcome:
    provisional = ", provisional" if answer.get("provisional") else ""
    lines = [f"{answer['verdict']}{provisional} (p_misfit {answer['p_misfit']:.2g})"]
    lines += [f"  {one['sentence']}" for one in answer.get("suspicions", ())]
    lines += [f"  {one['sentence']}" for one in answer.get("understated_noise", ())]
    for cause in answer["causes"]:
        tied = f" (or {', '.join(cause['group'][1:])})" if len(cause["group"]) > 1 else ""
        together = f", {cause['group_probability']:.2f} together" if tied else ""
        lines.append(f"  {cause['id']}{tied}, P = {cause['probability']:.2f}{together}: {cause['sentence']}")
        family = cause.get("family")
        if family is not None and family["alone"]:
            lines.append(f"    or another one of the {family['words']}: {family['reason']}")
    lines += [
        f"  not stated: {one['id']} fits, but its change differs by {one['differs_by']}, p = {one['p']:.1g}"
        for one in answer.get("constancy", ())
        if not one["holds"]
    ]
    lines += [
        f"  not stated: {one['id']} fits best of the causes, but {one['nearest']} explains the data as well"
        for one in answer.get("outside", ())
        if not one["holds"]
    ]
    lines += [
        f"  possible, but not stated: {one['id']}, P = {one['probability']:.2f}, log Bayes factor "
        f"{one['log_bayes_factor']:.1f} of {one['threshold']:.1f}"
        for one in answer["possible"]
    ]
    if answer.get("left"):
        lines.append(f"  {answer['left']['sentence']}")
    if answer.get("next_experiment"):
        lines.append(f"  next: {answer['next_experiment']['action']}")
    lines.append(seconds_line(clock.seconds, verbose=args.verbose))
    if args.out is not None:
        lines.append(f"written: {args.out}")
    code = UNTRUSTED if args.exit_code and answer["verdict"] != "consistent" else 0
    return Outcome({**answer, "seconds": clock.seconds}, "\n".join(lines), args.threads, code)
