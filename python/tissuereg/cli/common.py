"""Parts shared by all commands: result, common JSON entries, warnings and notes on standard error, clock."""

import contextlib
import logging
import signal
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TextIO

from tissuereg._base.machine import machine, n_cores, versions
from tissuereg._base.provenance import note_warning

#: Exit code of an answer that was found and written, but is not to be trusted.
UNTRUSTED = 4


@dataclass(frozen=True)
class Outcome:
    """The result of a command, which is printed and, on request, written as JSON.

    Attributes
    ----------
    content : dict
        Content of the JSON file, with ``schema`` and ``seconds``; the entries that all commands have are added later.
    summary : str
        Text of a few lines with the main content, for standard output.
    threads : int
        Requested number of threads; 0 stands for all cores.
    code : int
        Exit code: 0, 4 if the answer is written but not to be trusted, or 130 if it is that of a part.
    """

    content: dict[str, Any]
    summary: str
    threads: int = 0
    code: int = 0


def envelope(threads: int) -> dict[str, Any]:
    """Return the entries that the JSON of every command has: ``threads`` (0: all cores), ``machine``, ``versions``."""
    return {"threads": threads or n_cores(), "machine": machine(), "versions": versions()}


def paragraph(text: str) -> str:
    """Return a text as one paragraph, wrapped to lines of at most 100 characters; longer words are kept whole."""
    return textwrap.fill(" ".join(text.split()), 100, break_long_words=False, break_on_hyphens=False)


@contextlib.contextmanager
def warnings_as_lines(*, debug: bool) -> Iterator[list[str]]:
    """Print warnings inside the block as plain lines on standard error; yield a list that collects their texts.

    With `debug`, warnings for programmers (such as deprecations) are printed as well.
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
        note_warning(text)
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


@contextlib.contextmanager
def ended_by_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether the user asked for the end, by Ctrl-C, SIGTERM or SIGHUP.

    The first signal in the block is remembered, so that what is in hand can be finished; the second one interrupts.
    Signals that are ignored stay so; in another thread than the main one nothing is changed.
    """
    asked: list[int] = []

    def ask(number: int, _: Any) -> None:
        asked.append(number)
        if len(asked) > 1:
            raise KeyboardInterrupt
        note("what is in hand is finished and written; once more interrupts that too")

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, ask)
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def seconds_line(seconds: dict[str, float], *, verbose: bool = False) -> str:
    """Return the total of times by stage, in s, as one line of text; if `verbose`, after the times of all stages."""
    stages = [f"{name} {value:.3g} s" for name, value in seconds.items() if name != "total"] if verbose else []
    return ", ".join([*stages, f"total {seconds['total']:.3g} s"])


class Stopwatch:
    """Clock that divides the time of a command into named stages, which add up to the total."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> float:
        """Add the time since the last call (or the start) to the named stage, and return that time in s."""
        now = time.perf_counter()
        spent, self._last = now - self._last, now
        self._stages[stage] = self._stages.get(stage, 0.0) + spent
        return spent

    @property
    def seconds(self) -> dict[str, float]:
        """Time of every stage so far in s, and ``total`` up to now."""
        return {**self._stages, "total": time.perf_counter() - self._start}
