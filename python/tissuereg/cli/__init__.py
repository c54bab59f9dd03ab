"""The command ``tissuereg``: one module per command, with common output, errors and exit codes.

Exit codes: 0 done; 2 bad usage or bad input; 3 it could not be done; 4 answered and written, but not to be trusted; 130
interrupted; 1 is a bug.
"""

import contextlib
import errno
import importlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any

from tissuereg._base.provenance import recorded
from tissuereg.cli.common import Outcome, envelope, paragraph, warnings_as_lines
from tissuereg.cli.options import Parser, UsageError, command_text, json_target, parse
from tissuereg.errors import ConvergenceError, TissueRegError
from tissuereg.io.atomic import check_file_target
from tissuereg.io.json import dumps, write_json

#: Errors of the operating system that mean that no space is left.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

#: Commands with their purposes, in the order of the help. A command is the module of its name, loaded when it is used:
#: `HELP` says what it does, `options` adds its arguments, and `run` does it and returns an `Outcome`.
COMMANDS = {
    "mesh": "fill a surface with tetrahedra",
    "show": "draw a body, its node sets, markers and targets to a page that turns",
    "new": "begin an experiment on your own body",
    "solve": "solve one static problem",
    "simulate": "simulate an experiment, or a data set to train on",
    "train": "train a network on a data set",
    "calibrate": "measure what a trained model's answers are worth",
    "register": "register a body to its markers, load unknown, with regions",
    "warp": "move points, surfaces and images with a registered body, or write its grid transform",
    "track": "register a body frame after frame, from a recording of its markers",
    "live": "register a body to markers that come over the network (OpenIGTLink)",
    "advise": "say where the next markers should go",
    "diagnose": "find out what the simulation gets wrong",
    "demo": "register the embedded phantom, end to end",
    "bench": "time the parts",
    "cache": "say what is kept to save time, or delete it",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one ``tissuereg`` command and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Words of the command line after the program's name; by default those with which the process was started.

    Returns
    -------
    int
        Exit code: 0 done, 2 bad usage or input, 3 it could not be done, 4 written but not to be trusted, 130
        interrupted, 1 a bug.
    """
    return run_program(build_parser, argv)


def run_program(parser_of: Callable[[Sequence[str]], Parser], argv: Sequence[str] | None = None) -> int:
    """Parse a command line, run the command that it names, print or write its result, and turn errors into exit codes.

    Parameters
    ----------
    parser_of : callable of sequence of str -> Parser
        Function that returns the parser for the given command line. The parser's default ``run`` is the function that
        does the work.
    argv : sequence of str, optional
        Words of the command line after the program's name; by default those with which the process was started.

    Returns
    -------
    int
        Exit code: 0 done, 2 bad usage or input, 3 it could not be done, 4 written but not to be trusted, 130
        interrupted, 1 a bug.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    target, debug = json_target(words), "--debug" in words
    with _ended_like_an_interrupt(), recorded(command_text(words)), warnings_as_lines(debug=debug) as notes:
        try:
            outcome = _run(parser_of(words), words, target)
            if isinstance(outcome, int):
                return outcome
            _deliver(outcome, target, notes)
        except SystemExit as done:  # --help and --version
            return int(done.code or 0)
        except BaseException as error:
            return _fail(error, target, debug=debug)
    return outcome.code


def build_parser(words: Sequence[str] | None = None) -> Parser:
    """Return the parser of the whole command line.

    Parameters
    ----------
    words : sequence of str, optional
        Words of the command line. Only the module of the command that they name is loaded; all others appear in the
        help alone. By default all modules are loaded.

    Returns
    -------
    Parser
        Parser with one sub-parser per command.
    """
    from tissuereg._version import __version__

    parser = Parser(
        prog="tissuereg",
        description="Register a deformed soft organ to a few tracked markers, with honest uncertainty.",
        epilog=(
            "'tissuereg COMMAND --help' explains a command. Lengths mm, forces mN, stresses kPa, times s.\n"
            "Exit codes: 0 done, 2 bad usage or input, 3 it could not be done, 4 answered and written but not to be\n"
            "trusted (register, track, live, diagnose --exit-code), 130 interrupted, 1 a bug."
        ),
    )
    parser.add_argument("--version", action="version", version=f"tissuereg {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    named = None if words is None else next((word for word in words if not word.startswith("-")), "")
    for name, purpose in COMMANDS.items():
        if named in (None, name):
            command = importlib.import_module(f"tissuereg.cli.{name}")
            command.HELP.parser(commands, name, purpose, command.options).set_defaults(run=command.run)
        else:
            commands.add_parser(name, help=purpose)
    return parser


def _run(parser: Parser, words: list[str], target: str | None) -> Outcome | int:
    args = parse(parser, words)
    if target not in (None, "-"):
        check_file_target(target)
    if getattr(args, "speaks_for_itself", False):
        return int(args.run(args))
    with contextlib.redirect_stdout(sys.stderr) if target == "-" else contextlib.nullcontext():
        outcome: Outcome = args.run(args)
    return outcome


def _deliver(outcome: Outcome, target: str | None, notes: list[str]) -> None:
    if target is not None:
        _write(target, {**outcome.content, **envelope(outcome.threads), "warnings": notes})
    if target != "-":
        print(outcome.summary, flush=True)


def _write(target: str, content: dict[str, Any]) -> None:
    if target == "-":
        sys.stdout.write(dumps(content))
        sys.stdout.flush()
    else:
        write_json(target, content)


def _fail(error: BaseException, target: str | None, *, debug: bool) -> int:
    """Print the error, write it as JSON to `target` unless that is None, and return the exit code."""
    code, message = _verdict(error)
    if isinstance(error, OSError) and not isinstance(error, TissueRegError) and code == 2:
        _mute_stdout()
    if debug or code == 1:
        traceback.print_exception(error, file=sys.stderr)
    print(paragraph("interrupted" if code == 130 else f"error: {message}"), file=sys.stderr)
    if target is not None:
        content = {
            "schema": "tissuereg.error/1",
            "error": type(error).__name__,
            "message": message,
            "where": getattr(error, "where", None),
        }
        if isinstance(error, ConvergenceError) and error.report:
            content["report"] = error.report
        with contextlib.suppress(TissueRegError, OSError):  # the error itself may be that FILE cannot be written
            _write(target, content)
    return code


def _verdict(error: BaseException) -> tuple[int, str]:
    code = getattr(error, "exit_code", None)  # errors of the training package have their own base class
    if isinstance(code, int):
        return code, str(error)
    if isinstance(error, KeyboardInterrupt):
        return 130, "interrupted"
    if isinstance(error, MemoryError):
        return 3, "the memory of this machine must hold the problem; it does not: use a coarser mesh or fewer members"
    if isinstance(error, BrokenPipeError):
        return 2, "the reader of the output must stay; it closed the pipe"
    if isinstance(error, OSError) and error.errno in _NO_ROOM:
        return 2, f"there must be room for what is written, there is none: {error}"
    return 1, f"this is a bug in tissuereg, please report it with the lines above: {error or type(error).__name__}"


@contextlib.contextmanager
def _ended_like_an_interrupt() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP, unless ignored or handled, like Ctrl-C in the block: temporary files are removed."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _mute_stdout() -> None:
    """Discard the buffered standard output; otherwise Python would fail again when it flushes it at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


__all__ = ["Outcome", "UsageError", "build_parser", "main", "run_program"]
