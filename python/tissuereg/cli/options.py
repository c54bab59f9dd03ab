"""Parsers of the command line: common options, types of values, errors."""

import argparse
import contextlib
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, NoReturn

from tissuereg._base.arguments import MOST_THREADS
from tissuereg._base.fields import Check, whole
from tissuereg.errors import ArgumentError, TissueRegError


class UsageError(TissueRegError, ValueError):
    """The command line is invalid."""


def refuse(message: str, where: str) -> NoReturn:
    """Raise a `UsageError`."""
    raise UsageError(message, where=where)


class Parser(argparse.ArgumentParser):
    """argparse that raises instead of leaving the process, and takes no shortened options."""

    def __init__(self, **settings: Any) -> None:
        settings.setdefault("formatter_class", _HelpFormatter)
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise argparse's message as a `UsageError`."""
        text = f"{message}; '{self.prog} --help' explains the command"
        raise UsageError(text, where=self.prog)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=100)


#: Kinds of elements of a simulation.
ELEMENTS = ("tet4", "tet4-averaged", "tet10")

#: Help of ``--threads`` for results that are bitwise the same for any number.
_THREADS = "threads to use (default: all cores); the result does not depend on it"


@dataclass(frozen=True)
class Help:
    """What ``tissuereg COMMAND --help`` says besides the command's arguments.

    `details`: what the command does; `example`: a command line; `seed`, `threads`: help of these options; `seed` None
    leaves the option out.
    """

    details: str  # a paragraph below the purpose
    example: str  # command lines that work
    seed: str | None = None  # help of ``--seed``; None leaves the option out
    threads: str = _THREADS  # help of ``--threads``

    def parser(self, commands: Any, name: str, purpose: str, options: Callable[[Parser], None]) -> Parser:
        """Add a command's parser, its purpose in one line: with its own options, and those that every command has."""
        parser: Parser = commands.add_parser(name, help=purpose, **self.words(purpose))
        self.fill(parser, options)
        return parser

    def words(self, purpose: str) -> dict[str, str]:
        """Return the description and the example as arguments of a parser's constructor."""
        details = textwrap.fill(self.details, 98, break_on_hyphens=False)
        return {
            "description": f"{purpose[0].upper()}{purpose[1:]}.\n\n{details}",
            "epilog": f"example:\n{textwrap.indent(self.example, '  ')}",
        }

    def fill(self, parser: Parser, options: Callable[[Parser], None]) -> None:
        """Add a command's own options to its parser, and those that every command has."""
        options(parser)
        group = parser.add_argument_group("running")
        if self.seed is not None:
            add_option(group, "--seed", whole(self.seed, most=2**64 - 1, default=None), "N")
        add_option(group, "--threads", whole(self.threads, most=MOST_THREADS, default=0), "N")
        group.add_argument("--json", metavar="FILE", help="write one JSON object to FILE; - is standard output")
        group.add_argument("--quiet", action="store_true", help="no progress on standard error")
        group.add_argument("--debug", action="store_true", help="show the traceback of an error")


def option_type(check: Check) -> Callable[[str], Any]:
    """Return the argparse type of a field's check: it makes a checked value of a word, or raises ArgumentTypeError."""

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
    """Add an option `name`, with its dashes, whose type, range, help and default are those of a field.

    The field is `declared` by a function of `tissuereg._base.fields`, or is a record's:
    ``Settings.__dataclass_fields__["std_mm"]``. The option is required where it has no default. `metavar` names the
    value in the help; a choice needs none.
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
    """Raise a `UsageError` for outputs that would replace the command's own input; an input may be None."""
    read = {Path(file).resolve() for file in inputs if file is not None}
    for file in written:
        if file.resolve() in read:
            message = f"an output must not replace an input; {file} would, so choose another --out"
            raise UsageError(message, where=str(file))


def json_target(words: Sequence[str]) -> str | None:
    """Return the FILE of ``--json``, also from a line that is otherwise wrong; None where there is none."""
    scanner = Parser(add_help=False)
    scanner.add_argument("--json")
    with contextlib.suppress(UsageError):
        target: str | None = scanner.parse_known_args(list(words))[0].json
        return target
    return None
