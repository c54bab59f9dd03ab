"""Progress of a registration on standard error: its size as soon as it is known, then a line or a bar by stage."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from tissuereg.cli.common import note, paragraph

if TYPE_CHECKING:
    from tissuereg._base.clock import Progress

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


class Stages:
    """Shows stages and passes. `bar`: on a terminal; lines where there is none; `quiet`: show nothing."""

    def __init__(self, bar: Any, *, quiet: bool) -> None:
        self._bar, self._quiet = bar, quiet
        self._start = time.perf_counter()
        self._pass = ""

    def __call__(self, said: "Progress") -> None:
        """Show what a registration says; for use as the argument `progress` of `tissuereg.register`."""
        if said.kind == "pass":
            self._passed(said.done, said.most)
        elif said.kind == "stage" and not self._quiet:
            self._began(said.words)
        elif not self._quiet:
            self._clear()
            if said.kind == "warning":
                print(paragraph(f"warning: {said.words}"), file=sys.stderr)
            else:
                note(said.words)

    def _passed(self, done: int, in_all: int) -> None:
        """Show passes finished and passes at most."""
        if in_all > done:
            self._pass = f"pass {done + 1} of at most {in_all}: "
        if self._bar is not None:
            self._bar.total = in_all
            self._bar.update(done - self._bar.n)

    def _began(self, words: str) -> None:
        """Show the stage that begins."""
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
def stage_lines(*, quiet: bool) -> Iterator[Stages]:
    """Give an object that shows the stages of a registration on standard error.

    `quiet`: show nothing. Gives: a bar on a terminal, else lines; both only in runs of more than a few seconds.
    """
    if quiet or not sys.stderr.isatty():
        yield Stages(None, quiet=quiet)
        return
    from tqdm import tqdm

    with tqdm(file=sys.stderr, unit="", delay=_SILENT, leave=False) as bar:
        yield Stages(bar, quiet=False)
