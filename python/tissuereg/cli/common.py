"""Shared by all commands: the JSON envelope, warnings and progress on standard error, the clock."""

import contextlib
import logging
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TextIO

from tissuereg._base.machine import machine, n_cores, versions

Progress = Callable[[int, int], None]

#: Shortest and longest time in s between two lines of progress.
_FIRST_LINE, _LAST_LINE = 5.0, 60.0

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
    """Return the entries that the JSON of every command has.

    `threads`: requested number; 0 is all cores. Result: ``threads``, ``machine``, ``versions``.
    """
    return {"threads": threads or n_cores(), "machine": machine(), "versions": versions()}


def paragraph(text: str) -> str:
    """Return a text as one wrapped paragraph.

    `text`: any white space. Result: lines of at most 100 characters; long names are kept whole.
    """
    return textwrap.fill(" ".join(text.split()), 100, break_long_words=False, break_on_hyphens=False)


@contextlib.contextmanager
def warnings_as_lines(*, debug: bool) -> Iterator[list[str]]:
    """Show warnings to users as plain lines on standard error, and collect them.

    `debug`: show those for programmers (deprecations) as well. Gives: fills with what was shown.
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
    """Print a note, which is not a warning, on standard error in one line. `text`: any white space."""
    print(f"note: {' '.join(text.split())}", file=sys.stderr)


@contextlib.contextmanager
def progress_bar(what: str, *, quiet: bool) -> Iterator[Progress | None]:
    """Give a function that shows progress and the time left on standard error: a bar, or in a file a line at times.

    `what`: what is being counted; `quiet`: give None instead. Gives: takes the number done and the number in all.
    """
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from tqdm import tqdm

        with tqdm(desc=what, file=sys.stderr, unit="", delay=0.3) as bar:

            def report(done: int, in_all: int) -> None:
                bar.total = in_all
                bar.update(done - bar.n)

            yield report
    else:
        yield _Lines(what).report


class _Lines:
    """Progress as plain lines: a log file needs one now and then, no animation."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._start: tuple[float, int] | None = None
        self._next = 0.0

    def report(self, done: int, in_all: int) -> None:
        """Print a line if it is time for one."""
        now = time.monotonic()
        if self._start is None:  # what is done by then was there before
            self._start, self._next = (now, done), now + _FIRST_LINE
        if now < self._next or done >= in_all:
            return
        spent, fresh = now - self._start[0], done - self._start[1]
        self._next = now + max(_FIRST_LINE, min(_LAST_LINE, spent / 5))
        if fresh > 0:
            left = duration(spent / fresh * (in_all - done))
            print(f"{self._what}: {done} of {in_all}, about {left} left", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """Return a time in the unit that suits it: ``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def seconds_line(seconds: dict[str, float]) -> str:
    """Return the times of all stages in one line. `seconds`: by stage. Result: the total last."""
    stages = [f"{name} {value:.3g} s" for name, value in seconds.items() if name != "total"]
    return ", ".join([*stages, f"total {seconds['total']:.3g} s"])


class Stopwatch:
    """Splits the time of a command into stages that add up to its total."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> float:
        """Give the time since the last lap to a stage. Result: that time in s."""
        now = time.perf_counter()
        spent, self._last = now - self._last, now
        self._stages[stage] = self._stages.get(stage, 0.0) + spent
        return spent

    @property
    def seconds(self) -> dict[str, float]:
        """Time of every stage so far in s, and ``total`` up to now."""
        return {**self._stages, "total": time.perf_counter() - self._start}
