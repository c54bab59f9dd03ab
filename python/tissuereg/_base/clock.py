"""Wall time per stage, and what a long call says while it runs."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """A message of a long call about its progress.

    Attributes
    ----------
    kind : str
        ``"stage"``: a stage begins, or goes on; ``"pass"``: one iteration of a registration (linearise, sample, solve)
        is finished; ``"size"``: a remark on time and memory; ``"warning"``: a warning.
    words : str
        Name of the stage, on large bodies followed by the share that is done; or the text of the remark.
    done, most : int
        Of a ``"pass"``: passes finished and passes at most; 0 otherwise.
    """

    kind: str
    words: str
    done: int = 0
    most: int = 0


#: Takes what a call says.
Listener = Callable[[Progress], None]


class Clock:
    """Adds up the seconds spent in named stages, and notifies a listener when one begins.

    `listener`: called when a stage begins, when a pass is finished, and with every message that is passed to the method
    `tell`. `seconds`: wall time per stage, in the order in which the stages ended.
    """

    def __init__(self, listener: Listener | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._listener = listener

    def tell(self, kind: str, words: str) -> None:
        """Pass a message to the listener, if there is one."""
        if self._listener is not None:
            self._listener(Progress(kind, words))

    def passed(self, done: int, most: int) -> None:
        """Notify the listener of passes finished and passes at most."""
        if self._listener is not None:
            self._listener(Progress("pass", f"{done} of at most {most}", done, most))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block, also when it raises."""
        self.tell("stage", name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
