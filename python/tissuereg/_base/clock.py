"""Wall time per stage."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Takes the kind of a message (``"size"``, ``"warning"``, ``"stage"``), and its text.
Tell = Callable[[str, str], None]


class Clock:
    """Adds up the seconds spent in named stages, and notifies a listener when one begins.

    Parameters
    ----------
    tell : callable of (str, str), optional
        The listener: called with ``"stage"`` and the name when a stage begins, and with every message that is passed to
        the method `tell`.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time per stage, in the order in which the stages ended.
    """

    def __init__(self, tell: Tell | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._tell = tell

    def tell(self, kind: str, words: str) -> None:
        """Pass a message to the listener, if there is one."""
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
