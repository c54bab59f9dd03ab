"""The command ``tissuereg train``: trains a network on a data set, by the separate package tissuereg-training."""

import argparse
import importlib
import importlib.util
import sys

from tissuereg.cli.calibrate import add_pairs, calibrated
from tissuereg.cli.options import Help, Parser
from tissuereg.errors import MissingPackageError

HELP = Help(
    "Trains the network of RECIPE on the data set in DATA (made by 'tissuereg simulate RECIPE.toml --out DATA') and "
    "exports encoder.onnx, decoder.onnx, decoder_weights.npz and model.json to MODEL, which is then calibrated as by "
    "'tissuereg calibrate'; 'tissuereg register --model' takes it. Needs the package tissuereg-training, which "
    "brings torch: 'make training' in a checkout, or 'pip install ./training'.",
    example="tissuereg train phantom.toml --data data --out model",
    seed="seed of split, start and batches (default: the recipe's, or else 0)",
    threads="threads to use (default: all cores)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg train`` to its parser."""
    parser.add_argument("recipe", metavar="RECIPE.toml", help="table [train]; the recipe that made the data")
    text = "folder of the data set; given again: more members to train on, made with another seed"
    parser.add_argument("--data", required=True, action="append", metavar="DATA", help=text)
    parser.add_argument("--out", required=True, metavar="MODEL", help="folder for the model and its checkpoints")
    add_pairs(parser)
    start = parser.add_argument_group("start").add_mutually_exclusive_group()
    text = "continue from the last epoch, and fail where there is none (default: continue if there is one)"
    start.add_argument("--resume", action="store_true", help=text)
    start.add_argument("--fresh", action="store_true", help="start anew and discard the checkpoints")
    parser.set_defaults(speaks_for_itself=True)


def run(args: argparse.Namespace) -> int:
    """Run the training package, calibrate what it made, and return its exit code; MissingPackageError without it."""
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.toml import read_toml

    if importlib.util.find_spec("tissuereg_training") is None:
        message = (
            "the package tissuereg-training must be installed to train; it is not: run 'make training' in a checkout "
            "and use its environment, or 'pip install ./training' (it brings torch)"
        )
        raise MissingPackageError(message, where="tissuereg_training")
    check_folder_target(args.out)
    read_toml(args.recipe)  # bounds its size and depth
    training = importlib.import_module("tissuereg_training.cli")
    code = int(training.main(_words(args)))
    if code == 0:
        if not args.quiet:
            again = f"tissuereg calibrate {args.out} --data {args.data[0]}"
            print(f"trained; calibrating by trial registrations (if stopped: {again})", file=sys.stderr, flush=True)
        calibrated(args.out, args.data[0], args.pairs, args.patterns, args.seed or 0, quiet=args.quiet)
    return code


def _words(args: argparse.Namespace) -> list[str]:
    """Return the words of the command line for the parser of the training package."""
    flags = [f"--{name}" for name in ("resume", "fresh", "quiet", "debug") if getattr(args, name)]
    data = [f"--data={folder}" for folder in args.data]
    options = {"out": args.out, "threads": args.threads, "seed": args.seed, "json": args.json}
    given = [f"--{name}={value}" for name, value in options.items() if value is not None]
    return [args.recipe, *data, *given, *flags]
