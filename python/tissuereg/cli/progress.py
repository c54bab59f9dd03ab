"""Progress of long commands on standard error: counted tasks, and the stages of a registration."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from tissuereg.cli.common import note, paragraph

if TYPE_CHECKING:
    from tissuereg._base.clock import Progress

#: Takes the number done and the number in all.
Report = Callable[[int, int], None]

#: Shortest and longest time in s between two lines of progress.
_FIRST_LINE, _LAST_LINE = 5.0, 60.0

#: Descriptions of the stages that may take long.
_WORDS = {
    "body": "analysing the mesh: order of elimination, patches of contact",
    "linearise": "factoring the tangent",
    "sensitivities": "responses to forces",
    "sample": "sampling contacts",
    "solve": "solving for equilibrium",
    "spread": "regions of targets",
    "ensemble": "solving drawn loads",
    "assimilate": "assimilating",
    "draws": "draws for the spread of the nodes",
    "files": "writing files",
}

#: Runs shorter than this, in s, show no stages.
_SILENT = 2.0


@contextlib.contextmanager
def progress_bar(what: str, *, quiet: bool) -> Iterator[Report | None]:
    """Yield a function that shows progress and the remaining time on standard error; None if `quiet`.

    The function takes the number of tasks done and the number of all; `what` names the tasks. On a terminal it draws a
    bar, otherwise it prints a line from time to time.
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
    """Progress as plain lines, printed from time to time: for log files, in which a bar cannot be drawn."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._start: tuple[float, int] | None = None
        self._next = time.monotonic() + _FIRST_LINE

    def report(self, done: int, in_all: int) -> None:
        """Print a line with the tasks done, the number of all and the time left, if enough time has passed."""
        now = time.monotonic()
        if self._start is None:  # what is done by then was there before, or waited for what is made once
            self._start = (now, done)
        if now < self._next or done >= in_all:
            return
        spent, fresh = now - self._start[0], done - self._start[1]
        self._next = now + max(_FIRST_LINE, min(_LAST_LINE, spent / 5))
        left = f", about {duration(spent / fresh * (in_all - done))} left" if fresh > 0 else ""
        print(f"{self._what}: {done} of {in_all}{left}", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """Return a time in s as text in a suitable unit: ``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


class Stages:
    """Shows stages and iterations of a registration on standard error, in a tqdm bar or else lines (not if `quiet`).

    With `verbose`, remarks on the work too.
    """

    def __init__(self, bar: Any, *, quiet: bool, verbose: bool = False) -> None:
        self._bar, self._quiet, self._verbose = bar, quiet, verbose
        self._start = time.perf_counter()
        self._pass = ""

    def __call__(self, said: "Progress") -> None:
        """Show one message of a registration about its progress: an iteration, a stage, a warning or a remark."""
        if said.kind == "pass":
            self._passed(said.done, said.most)
        elif said.kind == "stage" and not self._quiet:
            self._began(said.words)
        elif not self._quiet and (self._verbose or said.kind != "work"):
            self._clear()
            if said.kind == "warning":
                print(paragraph(f"warning: {said.words}"), file=sys.stderr)
            else:
                note(said.words)

    def _passed(self, done: int, in_all: int) -> None:
        """Show the number of iterations of the registration that are done, and the largest number allowed."""
        if in_all > done:
            self._pass = f"pass {done + 1} of at most {in_all}: "
        if self._bar is not None:
            self._bar.total = in_all
            self._bar.update(done - self._bar.n)

    def _began(self, words: str) -> None:
        """Show the stage that begins; `words` is its name, on large bodies followed by the share that is done."""
        name, _, share = words.partition(" ")
        if name not in _WORDS:
            return
        if name in ("spread", "draws", "files"):
            self._pass = ""
        line = f"{self._pass}{_WORDS[name]}{share and f' {share}'}"
        if self._bar is not None:
            self._bar.set_description(line)
            return
        spent = time.perf_counter() - self._start
        if spent > _SILENT:
            print(f"{spent:.0f} s: {line}", file=sys.stderr)

    def _clear(self) -> None:
        if self._bar is not None:
            self._bar.clear()


@contextlib.contextmanager
def stage_lines(*, quiet: bool, verbose: bool = False) -> Iterator[Stages]:
    """Yield an object that shows the stages of a registration on standard error, nothing if `quiet`, more if `verbose`.

    On a terminal it draws a bar, otherwise it prints lines; both only in runs of more than a few seconds.
    """
    if quiet or not sys.stderr.isatty():
        yield Stages(None, quiet=quiet, verbose=verbose)
        return
    from tqdm import tqdm

    with tqdm(file=sys.stderr, unit="", delay=_SILENT, leave=False) as bar:
        yield Stages(bar, quiet=False, verbose=verbose)
