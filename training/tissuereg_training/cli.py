"""The commands: train a network of a recipe (`tissuereg train` goes through this one), or compare trained ones.

python -m tissuereg_training RECIPE.toml --data DATA --out MODEL
python -m tissuereg_training compare MODEL... --data DATA
"""

import argparse
import contextlib
import json
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from tissuereg_training.errors import OutputError, TissueRegError


class UsageError(TissueRegError, ValueError):
    """The words on the command line make no command."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        text = f"{message}; '{self.prog} --help' explains the command"
        raise UsageError(text, where=self.prog)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = _Parser(
        prog="tissuereg train",
        allow_abbrev=False,
        description="Train the graph network of a recipe on a data set, and export encoder.onnx, decoder.onnx, "
        "decoder_weights.npz and model.json.",
        epilog="example:\n  tissuereg train phantom.toml --data data --out model",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("recipe", metavar="RECIPE.toml", help="table [train]; the recipe that made the data")
    parser.add_argument(
        "--data",
        required=True,
        action="append",
        metavar="DATA",
        help="folder made by 'tissuereg simulate'; given again: more members to train on, made with another seed",
    )
    parser.add_argument("--out", required=True, metavar="MODEL", help="model folder, written whole or not at all")
    start = parser.add_mutually_exclusive_group()
    resume = "continue from the last epoch in MODEL.training, and fail where there is none (default: if there is one)"
    start.add_argument("--resume", dest="start", action="store_const", const="resume", help=resume)
    start.add_argument(
        "--fresh", dest="start", action="store_const", const="fresh", help="start anew, discard a checkpoint"
    )
    parser.add_argument("--threads", type=_whole, default=0, metavar="N", help="threads to use (default: all cores)")
    parser.add_argument("--seed", type=_whole, metavar="N", help="instead of the recipe's seed, which is 0 by default")
    parser.add_argument("--json", metavar="FILE", help="write one JSON object to FILE; - is standard output")
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.set_defaults(start="auto")
    return parser


def build_compare_parser() -> argparse.ArgumentParser:
    """Return the parser of `compare`."""
    parser = _Parser(
        prog="tissuereg-train compare",
        allow_abbrev=False,
        description="Measure networks beside principal components and the constant mean shape on the same splits.",
    )
    parser.add_argument("models", nargs="+", metavar="MODEL", help="model folders")
    parser.add_argument("--data", required=True, metavar="DATA", help="data set with the splits to measure on")
    page = "also write the table into FILE, between '<!-- networks: begin -->' and '<!-- networks: end -->'"
    parser.add_argument("--page", metavar="FILE", help=page)
    parser.add_argument("--json", metavar="FILE", help="write one JSON object to FILE; - is standard output")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str, optional
        Words after the program's name; those of the process where absent.

    Returns
    -------
    int
        0 done, 2 bad usage or input, 3 it could not be done, 130 interrupted, 1 a bug.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    target = _json_target(words)
    try:
        if words[:1] == ["compare"]:
            _compare(build_compare_parser().parse_args(words[1:]), target)
            return 0
        args = build_parser().parse_args(words)
        if args.json not in (None, "-") and Path(args.json).is_dir():
            message = f"the JSON must go to a file, {args.json} is a folder"
            raise OutputError(message, where=args.json)
        from tissuereg_training.fit import to_stderr
        from tissuereg_training.pipeline import train

        content = train(
            args.recipe,
            args.data,
            args.out,
            seed=args.seed,
            threads=args.threads,
            start=args.start,
            report=None if args.quiet else to_stderr,
        )
        _deliver(content, target, args.out)
    except SystemExit as done:  # --help
        return int(done.code or 0)
    except BaseException as error:
        return _fail(error, target, debug="--debug" in words)
    return 0


def run() -> NoReturn:
    """Run the command and leave the process with its exit code."""
    sys.exit(main())


def _whole(word: str) -> int:
    try:
        value = int(word)
    except ValueError:
        value = -1
    if value < 0:
        message = f"must be a whole number of at least 0, got {word!r}"
        raise argparse.ArgumentTypeError(message)
    return value


def _json_target(words: Sequence[str]) -> str | None:
    for word, after in zip(words, [*words[1:], None], strict=True):
        if word == "--json":
            return after
        if word.startswith("--json="):
            return word.removeprefix("--json=")
    return None


def _compare(args: argparse.Namespace, target: str | None) -> None:
    from tissuereg_training.compare import compare, table, write_into

    content = compare(args.models, args.data)
    text = table(content)
    if args.page is not None:
        write_into(args.page, text)
    if target is not None:
        _write_json(target, content)
    if target != "-":
        print(text, end="")


def _deliver(content: dict[str, Any], target: str | None, out: str) -> None:
    if target is not None:
        _write_json(target, content)
    if target != "-":
        errors = ", ".join(f"{name} {value:.4f}" for name, value in content["errors_mm"].items())
        print(f"{content['epochs']} epochs, best {content['best_epoch']}; {content['seconds']['total']:.1f} s")
        print(f"mean error in mm: {errors} (pca: as many principal components, same split)")
        print(f"written: {out}")


def _fail(error: BaseException, target: str | None, *, debug: bool) -> int:
    if isinstance(error, TissueRegError):
        code, message = error.exit_code, str(error)
    elif isinstance(error, KeyboardInterrupt):
        code, message = 130, "interrupted; the last whole epoch is kept, run the command again to continue"
    else:
        code, message = (
            1,
            f"this is a bug in tissuereg-training, please report it: {error or type(error).__name__}",
        )
    if debug or code == 1:
        traceback.print_exception(error, file=sys.stderr)
    print(message if code == 130 else f"error: {message}", file=sys.stderr)
    if target is not None:
        where = getattr(error, "where", None)
        content = {
            "schema": "tissuereg.error/1",
            "error": type(error).__name__,
            "message": message,
            "where": where,
        }
        with contextlib.suppress(OSError):  # the error itself may be that FILE cannot be written
            _write_json(target, content)
    return code


def _write_json(target: str, content: dict[str, Any]) -> None:
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    path = Path(target)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_name(f".{path.name}.part")  # of a killed run: the next one writes over it
        try:
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        message = f"the JSON file {path} must be writable: {error.strerror or error}"
        raise OutputError(message, where=str(path)) from error
