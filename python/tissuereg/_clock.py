"""Wall time per stage."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Takes what kind of thing is said (``"size"``, ``"warning"``, ``"stage"``), and the words.
Tell = Callable[[str, str], None]


class Clock:
    """Adds up the seconds spent in named stages, and tells a listener what begins.

    Parameters
    ----------
    tell : callable of (str, str), optional
        Called with ``"stage"`` and the name when a stage begins, and with whatever `tell` is given.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time per stage, in the order in which the stages ended.
    """

    def __init__(self, tell: Tell | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._tell = tell

    def tell(self, kind: str, words: str) -> None:
        """Say something to the listener, where there is one."""
        if self._tell is not None:
            self._tell(kind, words)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block, also when it raises."""
        self.tell("stage", name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
