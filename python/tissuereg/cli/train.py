"""``tissuereg train``: a network from a data set, by the separate package tissuereg-training."""

import argparse
import importlib
import importlib.util
from typing import Any

from tissuereg.cli.common import Outcome, seconds_line
from tissuereg.cli.options import add_common, command_parser
from tissuereg.errors import MissingPackageError

_DETAILS = (
    "Trains the network of RECIPE on the data set in DATA (made by 'tissuereg simulate RECIPE.toml --out DATA') and "
    "exports encoder.onnx, decoder.onnx, decoder_weights.npz and model.json to MODEL; 'tissuereg register --model' "
    "takes it. Needs the package tissuereg-training, which brings torch: 'make training' in a checkout, or "
    "'pip install ./training'."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    example = "tissuereg train phantom.toml --data data --out model"
    parser = command_parser(commands, "train", "train a network on a data set", _DETAILS, example)
    parser.add_argument("recipe", metavar="RECIPE.toml", help="table [train]; the recipe that made the data")
    parser.add_argument("--data", required=True, metavar="DATA", help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="MODEL", help="folder for the model and its checkpoints")
    add_common(parser, seed="seed of split, start and batches (default: the recipe's, which is 0 unless it says so)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Hand over to the training package.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.train/1``.

    Raises
    ------
    MissingPackageError
        If the training package is not installed.
    """
    from tissuereg.io.atomic import check_folder_target

    if importlib.util.find_spec("tissuereg_training") is None:
        message = (
            "the package tissuereg-training must be installed to train; it is not: run 'make training' in a checkout "
            "and use its environment, or 'pip install ./training' (it brings torch)"
        )
        raise MissingPackageError(message, where="tissuereg_training")
    check_folder_target(args.out)
    training = importlib.import_module("tissuereg_training.cli")
    trained: dict[str, Any] = training.main(
        args.recipe, args.data, args.out, seed=args.seed, threads=args.threads, progress=not args.quiet
    )
    content = {"schema": "tissuereg.train/1", **trained}
    return Outcome(content, _summary(content, args.out), args.threads)


def _summary(content: dict[str, Any], out: str) -> str:
    errors = content["errors_mm"]
    told = ", ".join(f"{name} {errors[name]:.3f}" for name in ("train", "valid", "test", "pca") if name in errors)
    return "\n".join(
        [
            f"{content['epochs']} epochs; mean error in mm: {told} (pca: as many principal components, same split)",
            seconds_line(content["seconds"]),
            f"written: {out}",
        ]
    )
