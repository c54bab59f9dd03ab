"""The command ``tissuereg new``: writes the folder of an experiment to begin with."""

import argparse

from tissuereg.cli.common import Outcome
from tissuereg.cli.options import Help, Parser
from tissuereg.cli.progress import progress_bar

HELP = Help(
    "DIR gets an experiment.toml with every key of the format and a comment for each, and tables of two made-up pushes "
    "on your body, so that 'simulate' and 'diagnose' take it at once. Replace pads, markers and tables one by one by "
    "what you measured. The format: docs/experiment.md.",
    example="tissuereg new my-rig --mesh body.vtu",
    seed="seed of noise (default: 0)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg new`` to its parser."""
    parser.add_argument("out", metavar="DIR", help="folder to write: new or empty")
    text = "tetrahedra in mm (.vtu, .vtk, .msh, .npz); stays where it is"
    parser.add_argument("--mesh", required=True, metavar="BODY.vtu", help=text)
    text = (
        "held nodes: 'plane nx ny nz d [tol]', 'ball x y z r' or the name of a node set (default: the set 'fixed', or "
        "the lowest nodes along z)"
    )
    parser.add_argument("--fixed", metavar="RULE", help=text)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg new``: write an experiment folder; JSON schema ``tissuereg.new/1``."""
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
