"""Shared by all commands: the result, the JSON envelope, warnings and notes on standard error, the clock."""

import contextlib
import logging
import sys
import textwrap
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TextIO

from tissuereg._base.machine import machine, n_cores, versions

#: Exit code of an answer that was found and written, but is not to be trusted.
UNTRUSTED = 4


@dataclass(frozen=True)
class Outcome:
    """The result that a command prints.

    Attributes
    ----------
    content : dict
        JSON content with ``schema`` and ``seconds``; `envelope` is added to it.
    summary : str
        The same as text, a few lines.
    threads : int
        Requested threads; 0 is all cores.
    code : int
        Exit code: 0, or `UNTRUSTED`.
    """

    content: dict[str, Any]
    summary: str
    threads: int = 0
    code: int = 0


def envelope(threads: int) -> dict[str, Any]:
    """Return the entries that the JSON of every command has: ``threads`` (0: all cores), ``machine``, ``versions``."""
    return {"threads": threads or n_cores(), "machine": machine(), "versions": versions()}


def paragraph(text: str) -> str:
    """Return a text as one wrapped paragraph: lines of at most 100 characters; long names are kept whole."""
    return textwrap.fill(" ".join(text.split()), 100, break_long_words=False, break_on_hyphens=False)


@contextlib.contextmanager
def warnings_as_lines(*, debug: bool) -> Iterator[list[str]]:
    """Show warnings to users as plain lines on standard error; yield a list that fills with what was shown.

    `debug` shows those for programmers (deprecations) as well.
    """
    notes: list[str] = []

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = " ".join(str(message).split())
        notes.append(text)
        print(paragraph(f"warning: {text}"), file=sys.stderr)

    # matplotlib warns if it cannot write its font cache; users of a command can do nothing about that.
    logging.getLogger("matplotlib").setLevel(logging.WARNING if debug else logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("default" if debug else "ignore")
        warnings.filterwarnings("default", category=UserWarning)
        warnings.showwarning = show
        yield notes


def note(text: str) -> None:
    """Print a note, which is not a warning, on standard error in one line."""
    print(f"note: {' '.join(text.split())}", file=sys.stderr)


def seconds_line(seconds: dict[str, float]) -> str:
    """Return the times of all stages in one line, the total last."""
    stages = [f"{name} {value:.3g} s" for name, value in seconds.items() if name != "total"]
    return ", ".join([*stages, f"total {seconds['total']:.3g} s"])


class Stopwatch:
    """Splits the time of a command into stages that add up to its total."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> float:
        """Give the time since the last lap to a stage, and return it in s."""
        now = time.perf_counter()
        spent, self._last = now - self._last, now
        self._stages[stage] = self._stages.get(stage, 0.0) + spent
        return spent

    @property
    def seconds(self) -> dict[str, float]:
        """Time of every stage so far in s, and ``total`` up to now."""
        return {**self._stages, "total": time.perf_counter() - self._start}
