"""Wall time per stage of a long call, and messages about its progress."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tissuereg._base.provenance import note_warning


@dataclass(frozen=True)
class Progress:
    """A message that a long call passes to the user's function while it runs.

    Attributes
    ----------
    kind : str
        ``"stage"``: a stage begins, or goes on; ``"pass"``: one iteration of a registration (linearise, sample, solve)
        is finished; ``"size"``: a remark on time and memory; ``"work"``: one on unknowns and factorisations;
        ``"warning"``: a warning.
    words : str
        Name of the stage, on large bodies followed by the share that is done; or the text of the remark.
    done, most : int
        For a ``"pass"``, the number of iterations finished and the largest number of iterations; 0 for other kinds.
    """

    kind: str
    words: str
    done: int = 0
    most: int = 0


#: Takes what a call says.
Listener = Callable[[Progress], None]


class Clock:
    """Adds up the seconds spent in named stages, and notifies a listener when one begins.

    `listener`: function of one `Progress`, called when a stage begins, when an iteration of a registration is finished,
    and with every message that is passed to the method `tell`; None for no messages. The attribute `seconds` holds the
    wall time in s of each stage by name, in the order in which the stages first ended.
    """

    def __init__(self, listener: Listener | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._listener = listener

    def tell(self, kind: str, words: str) -> None:
        """Pass a message of the given kind (see `Progress.kind`) and text to the listener, if there is one."""
        if kind == "warning":
            note_warning(words)
        if self._listener is not None:
            self._listener(Progress(kind, words))

    def passed(self, done: int, most: int) -> None:
        """Notify the listener that `done` of at most `most` iterations of a registration are finished."""
        if self._listener is not None:
            self._listener(Progress("pass", f"{done} of at most {most}", done, most))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Notify the listener of a stage, time the block, and add its wall time to `seconds`, even if it raises."""
        self.tell("stage", name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
