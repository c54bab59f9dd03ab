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

from tissuereg._machine import machine, n_cores, versions

Progress = Callable[[int, int], None]

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

    Parameters
    ----------
    threads : int
        Requested number; 0 is all cores.

    Returns
    -------
    dict
        ``threads``, ``machine``, ``versions``.
    """
    return {"threads": threads or n_cores(), "machine": machine(), "versions": versions()}


def paragraph(text: str) -> str:
    """Return a text as one wrapped paragraph.

    Parameters
    ----------
    text : str
        Any white space.

    Returns
    -------
    str
        Lines of at most 100 characters; long names are kept whole.
    """
    return textwrap.fill(" ".join(text.split()), 100, break_long_words=False, break_on_hyphens=False)


@contextlib.contextmanager
def warnings_as_lines(*, debug: bool) -> Iterator[list[str]]:
    """Show warnings to users as plain lines on standard error, and collect them.

    Parameters
    ----------
    debug : bool
        Show those for programmers (deprecations) as well.

    Yields
    ------
    list of str
        Fills with what was shown.
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
    """Print a note, which is not a warning, on standard error in one line.

    Parameters
    ----------
    text : str
        Any white space.
    """
    print(f"note: {' '.join(text.split())}", file=sys.stderr)


@contextlib.contextmanager
def progress_bar(what: str, *, quiet: bool) -> Iterator[Progress | None]:
    """Give a function that shows progress on standard error.

    Parameters
    ----------
    what : str
        What is being counted.
    quiet : bool
        Give None instead.

    Yields
    ------
    callable of (int, int) or None
        Takes the number done and the number in all.
    """
    if quiet:
        yield None
        return
    from tqdm import tqdm

    pause = 0.1 if sys.stderr.isatty() else 5.0  # a log file needs a line now and then, no animation
    with tqdm(desc=what, file=sys.stderr, unit="", delay=0.3, mininterval=pause, maxinterval=pause) as bar:

        def report(done: int, in_all: int) -> None:
            bar.total = in_all
            bar.update(done - bar.n)

        yield report


def seconds_line(seconds: dict[str, float]) -> str:
    """Return the times of all stages in one line.

    Parameters
    ----------
    seconds : dict of str to float
        By stage.

    Returns
    -------
    str
        The total last.
    """
    stages = [f"{name} {value:.3g} s" for name, value in seconds.items() if name != "total"]
    return ", ".join([*stages, f"total {seconds['total']:.3g} s"])


class Stopwatch:
    """Splits the time of a command into stages that add up to its total."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> float:
        """Give the time since the last lap to a stage.

        Parameters
        ----------
        stage : str
            Its name.

        Returns
        -------
        float
            That time in s.
        """
        now = time.perf_counter()
        spent, self._last = now - self._last, now
        self._stages[stage] = self._stages.get(stage, 0.0) + spent
        return spent

    @property
    def seconds(self) -> dict[str, float]:
        """Time of every stage so far in s, and ``total`` up to now."""
        return {**self._stages, "total": time.perf_counter() - self._start}
