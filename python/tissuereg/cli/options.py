"""Parsers of the command line: options that all commands have, types of values, usage errors."""

import argparse
import contextlib
import shlex
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, NoReturn

from tissuereg._base.arguments import MOST_THREADS
from tissuereg._base.fields import Check, whole
from tissuereg.errors import ArgumentError, TissueRegError


class UsageError(TissueRegError, ValueError):
    """Error that is raised for an invalid command line."""


def refuse(message: str, where: str) -> NoReturn:
    """Raise a `UsageError` with a message and the name of the argument that it is about."""
    raise UsageError(message, where=where)


class Parser(argparse.ArgumentParser):
    """Argument parser that raises UsageError instead of leaving the process, and takes no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        settings.setdefault("formatter_class", _HelpFormatter)
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise the message of argparse as a `UsageError`."""
        text = f"{message}; '{self.prog} --help' explains the command"
        raise UsageError(text, where=self.prog)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=100)


#: Help of ``--threads`` for results that are bitwise the same for any number.
_THREADS = "threads to use (default: all cores); the result does not depend on it"


@dataclass(frozen=True)
class Help:
    """Texts of ``tissuereg COMMAND --help`` besides those of the command's own arguments.

    `details`: paragraph on what the command does; `example`: command lines that work; `seed`, `threads`: help of
    ``--seed`` and ``--threads``; if `seed` is None, the command has no such option.
    """

    details: str  # a paragraph below the purpose
    example: str  # command lines that work
    seed: str | None = None  # help of ``--seed``; None leaves the option out
    threads: str = _THREADS  # help of ``--threads``

    def parser(self, commands: Any, name: str, purpose: str, options: Callable[[Parser], None]) -> Parser:
        """Add and return a command's parser; `purpose`: a line of help; `options`: adds the command's arguments."""
        parser: Parser = commands.add_parser(name, help=purpose, **self.words(purpose))
        self.fill(parser, options)
        return parser

    def words(self, purpose: str) -> dict[str, str]:
        """Return description and example as keyword arguments of a parser; `purpose` is a line on the command."""
        details = textwrap.fill(self.details, 98, break_on_hyphens=False)
        return {
            "description": f"{purpose[0].upper()}{purpose[1:]}.\n\n{details}",
            "epilog": f"example:\n{textwrap.indent(self.example, '  ')}",
        }

    def fill(self, parser: Parser, options: Callable[[Parser], None]) -> None:
        """Add a command's own options, by the function `options`, and those that all commands have to its parser."""
        options(parser)
        group = parser.add_argument_group("running")
        if self.seed is not None:
            add_option(group, "--seed", whole(self.seed, most=2**64 - 1, default=None), "N")
        add_option(group, "--threads", whole(self.threads, most=MOST_THREADS, default=0), "N")
        group.add_argument("--json", metavar="FILE", help="write one JSON object to FILE; - is standard output")
        group.add_argument("--quiet", action="store_true", help="no progress on standard error")
        group.add_argument("--verbose", action="store_true", help="also say what is of use to numericists: work, times")
        group.add_argument("--debug", action="store_true", help="show the traceback of an error")


def option_type(check: Check) -> Callable[[str], Any]:
    """Return an argparse type: a function that makes a checked value of a word or raises ArgumentTypeError."""

    def value(word: str) -> Any:
        try:
            given = check.read(word)
        except ValueError:
            given = word
        try:
            return check.take("", given, error=ArgumentError)
        except ArgumentError as error:
            raise argparse.ArgumentTypeError(str(error).removeprefix("`` ")) from error

    return value


def add_option(to: Any, name: str, declared: Any, metavar: str | None = None) -> None:
    """Add an option to a parser or group; type, range, help and default are those of a declared field.

    `name`: option with its dashes; `declared`: field that a function of `tissuereg._base.fields` declares, or that of a
    record, such as ``Settings.__dataclass_fields__["std_mm"]``. The option is required if the field has no default.
    `metavar` names the value in the help; a choice needs none.
    """
    check: Check = declared.metadata["check"]
    text = check.meaning
    if check.unit and f"in {check.unit}" not in text:
        text += f", in {check.unit}"
    usual = check.otherwise or ("" if declared.default in (None, MISSING) else _shown(declared.default))
    if usual and "(default: " not in text:
        text += f" (default: {usual})"
    settings = {"required": True} if declared.default is MISSING else {"default": declared.default}
    settings |= {"choices": check.choices} if check.choices else {"type": option_type(check), "metavar": metavar}
    to.add_argument(name, help=text.replace("%", "%%"), **settings)


def _shown(default: Any) -> str:
    return f"{default:g}" if isinstance(default, int | float) else str(default)


def parse(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; positional words after options may continue a list from before them.

    argparse does not accept such words (Python issue 15112), so a command's defaults ``late`` and ``room`` name the
    list that they are added to, and the number of words allowed. Raises UsageError if a word has no meaning.
    """
    args, rest = parser.parse_known_args(list(words))
    room = getattr(args, "room", 0)
    if rest and (len(rest) > room or any(word.startswith("-") for word in rest)):
        command = " ".join([parser.prog, *([args.command] if hasattr(args, "command") else [])])
        message = f"no such argument: {' '.join(rest)}; '{command} --help' explains the command"
        raise UsageError(message, where=" ".join(rest))
    if rest:
        getattr(args, args.late).extend(rest)
    return args


def refuse_overwriting(written: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """Raise UsageError if a file of `written` is one of `inputs`, the files that a command reads (None is ignored)."""
    read = {Path(file).resolve() for file in inputs if file is not None}
    for file in written:
        if file.resolve() in read:
            message = f"an output must not replace an input; {file} would, so choose another --out"
            raise UsageError(message, where=str(file))


#: Options that change no answer: where it is written and what is said of it. Those of the first line have a value.
_BESIDE = {"--out": 1, "--json": 1, "--threads": 1, "--image": 1} | dict.fromkeys(
    ("--quiet", "--debug", "--verbose", "--no-picture", "--deformed", "--fields", "--report"), 0
)


def command_text(words: Sequence[str]) -> str:
    """Return a command line as text for a result, without the options that change no answer.

    >>> command_text(["register", "body.vtu", "--out", "a folder", "--fixed", "ball 0 0 0 5", "--json=-"])
    "tissuereg register body.vtu --fixed 'ball 0 0 0 5'"
    """
    kept, skipped = ["tissuereg"], 0
    for word in words:
        name, _, value = word.partition("=")
        if skipped or name in _BESIDE:
            skipped = skipped - 1 if skipped else _BESIDE[name] if not value else 0
        else:
            kept.append(word)
    return shlex.join(kept)


def json_target(words: Sequence[str]) -> str | None:
    """Return the file name that follows ``--json``, even if the rest of the line is wrong; None without the option."""
    scanner = Parser(add_help=False)
    scanner.add_argument("--json")
    with contextlib.suppress(UsageError):
        target: str | None = scanner.parse_known_args(list(words))[0].json
        return target
    return None
