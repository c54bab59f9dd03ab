"""One thread of BLAS while calls of this package run: faster for small matrices, and with the same bits everywhere."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import threadpoolctl

_lock = threading.Lock()
_count = 0
#: Limits that hold now, with the libraries that each is of.
_held: list[tuple["BlasThreads", Any]] = []


def _may_set() -> None:
    """Let any thread set the number next: newer threadpoolctl obeys the first that did alone, and ignores others."""
    clear = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if clear is not None:
        clear(force=True)


class BlasThreads:
    """The libraries of BLAS that are loaded when it is made."""

    def __init__(self) -> None:
        self._libraries = threadpoolctl.ThreadpoolController().select(user_api="blas")

    @contextmanager
    def one(self) -> Iterator[None]:
        """Let them use one thread in the block.

        The number is one of the whole process: it is set back when the last of the blocks that run beside each other,
        in any threads, has ended.
        """
        global _count
        with _lock:
            if all(libraries is not self for libraries, _ in _held):
                _may_set()
                _held.append((self, self._libraries.limit(limits=1)))
            _count += 1
        try:
            yield
        finally:
            with _lock:
                _count -= 1
                while not _count and _held:
                    _may_set()
                    _held.pop()[1].restore_original_limits()
                _may_set()


__all__ = ["BlasThreads"]
