"""Parsers of the command line: common options, types of values, errors."""

import argparse
import contextlib
import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from tissuereg.errors import TissueRegError


class UsageError(TissueRegError, ValueError):
    """The command line is invalid."""


class Parser(argparse.ArgumentParser):
    """argparse that raises instead of leaving the process, and takes no shortened options."""

    def __init__(self, **settings: Any) -> None:
        settings.setdefault("formatter_class", _HelpFormatter)
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise a `UsageError`.

        Parameters
        ----------
        message : str
            argparse's message.

        Raises
        ------
        UsageError
            Always.
        """
        text = f"{message}; '{self.prog} --help' explains the command"
        raise UsageError(text, where=self.prog)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=100)


def command_parser(commands: Any, name: str, purpose: str, details: str, example: str) -> Parser:
    """Return the parser of one command.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to add it.
    name : str
        Of the command.
    purpose : str
        One line.
    details : str
        A paragraph below it.
    example : str
        A command line that works.

    Returns
    -------
    Parser
        To which the command adds its arguments.
    """
    description = "\n\n".join(
        [f"{purpose[0].upper()}{purpose[1:]}.", textwrap.fill(details, 98, break_on_hyphens=False)]
    )
    parser: Parser = commands.add_parser(name, help=purpose, description=description, epilog=f"example:\n  {example}")
    return parser


#: Help of ``--threads`` for results that are bitwise the same for any number.
_THREADS = "threads to use (default: all cores); the result does not depend on it"


def add_common(parser: Parser, *, seed: str | None = None, threads: str = _THREADS) -> None:
    """Add the options that every command has.

    Parameters
    ----------
    parser : Parser
        Of the command.
    seed : str, optional
        Help of ``--seed``; None leaves the option out.
    threads : str
        Help of ``--threads``.
    """
    group = parser.add_argument_group("running")
    if seed is not None:
        group.add_argument("--seed", type=whole_number(0), metavar="N", help=seed)
    group.add_argument("--threads", type=whole_number(0), default=0, metavar="N", help=threads)
    group.add_argument("--json", metavar="FILE", help="write one JSON object to FILE; - is standard output")
    group.add_argument("--quiet", action="store_true", help="no progress on standard error")
    group.add_argument("--debug", action="store_true", help="show the traceback of an error")


def parse(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; positional words after options may continue a list from before them.

    Parameters
    ----------
    parser : Parser
        Of the whole command line.
    words : sequence of str
        After the program's name.

    Returns
    -------
    argparse.Namespace
        argparse does not accept such words (Python issue 15112), so a command's defaults ``late`` and ``room`` name
        the list that they are added to, and the number of words allowed.

    Raises
    ------
    UsageError
        If a word has no meaning.
    """
    args, rest = parser.parse_known_args(list(words))
    room = getattr(args, "room", 0)
    if rest and (len(rest) > room or any(word.startswith("-") for word in rest)):
        message = f"no such argument: {' '.join(rest)}; '{parser.prog} {args.command} --help' explains the command"
        raise UsageError(message, where=" ".join(rest))
    if rest:
        getattr(args, args.late).extend(rest)
    return args


def whole_number(least: int) -> Callable[[str], int]:
    """Return an argparse type for whole numbers.

    Parameters
    ----------
    least : int
        Smallest that is allowed.

    Returns
    -------
    callable
        Text to int.

    Raises
    ------
    argparse.ArgumentTypeError
        From the callable, if a text is no such number.
    """

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            message = f"must be a whole number of at least {least}, got '{text}'"
            raise argparse.ArgumentTypeError(message)
        return value

    return parse


def positive_number(text: str) -> float:
    """Return a positive, finite number; an argparse type.

    Parameters
    ----------
    text : str
        As typed.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is none.
    """
    value = finite_number(text)
    if value <= 0:
        message = f"must be positive, got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return value


def finite_number(text: str) -> float:
    """Return a finite number; an argparse type.

    Parameters
    ----------
    text : str
        As typed.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        message = f"must be a finite number, got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return value


def refuse_overwriting(written: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """Refuse outputs that would replace the command's own input.

    Parameters
    ----------
    written : iterable of Path
        Files that the command is going to write.
    inputs : iterable of str, Path or None
        Files that it reads; None where one is not given.

    Raises
    ------
    UsageError
        If a file is both.
    """
    read = {Path(file).resolve() for file in inputs if file is not None}
    for file in written:
        if file.resolve() in read:
            message = f"an output must not replace an input; {file} would, so choose another --out"
            raise UsageError(message, where=str(file))


def json_target(words: Sequence[str]) -> str | None:
    """Return the FILE of ``--json``, also from a line that is otherwise wrong.

    Parameters
    ----------
    words : sequence of str
        The command line.

    Returns
    -------
    str or None
        None where there is no such option.
    """
    scanner = Parser(add_help=False)
    scanner.add_argument("--json")
    with contextlib.suppress(UsageError):
        target: str | None = scanner.parse_known_args(list(words))[0].json
        return target
    return None
