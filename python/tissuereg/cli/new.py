"""``tissuereg new``: the folder of an experiment to begin with."""

import argparse
from typing import Any

from tissuereg.cli.common import Outcome, progress_bar
from tissuereg.cli.options import add_common, command_parser

_DETAILS = (
    "DIR gets an experiment.toml with every key of the format and a comment for each, and tables of two made-up pushes "
    "on your body, so that 'simulate' and 'diagnose' take it at once. Replace pads, markers and tables one by one by "
    "what you measured. The format: docs/experiment.md."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "begin an experiment on your own body"
    parser = command_parser(commands, "new", purpose, _DETAILS, "tissuereg new my-rig --mesh body.vtu")
    parser.add_argument("out", metavar="DIR", help="folder to write: new or empty")
    text = "tetrahedra in mm (.vtu, .vtk, .msh, .npz); stays where it is"
    parser.add_argument("--mesh", required=True, metavar="BODY.vtu", help=text)
    text = (
        "held nodes: 'plane nx ny nz d [tol]', 'ball x y z r' or the name of a node set (default: the set 'fixed', or "
        "the lowest nodes along z)"
    )
    parser.add_argument("--fixed", metavar="RULE", help=text)
    add_common(parser, seed="seed of noise (default: 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Write the folder.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.new/1``.
    """
    from tissuereg.cli.skeleton import new_experiment

    with progress_bar("frames", quiet=args.quiet) as progress:
        begun = new_experiment(
            args.out, args.mesh, fixed=args.fixed, seed=args.seed or 0, threads=args.threads, progress=progress
        )
    lines = [
        *(f"guessed: {sentence}" for sentence in begun.guessed),
        f"written: {', '.join(begun.files)} in {args.out}",
        f"next: edit {args.out}/experiment.toml; 'tissuereg diagnose {args.out} --out diagnosed' runs already",
    ]
    content = {"schema": "tissuereg.new/1", "files": list(begun.files), "guessed": list(begun.guessed)}
    return Outcome(content, "\n".join(lines), args.threads)
