"""Processes of this machine that need no further package: for runs of cases side by side."""

import multiprocessing
import multiprocessing.process
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from typing import Any

from tissuereg._base.arguments import whole
from tissuereg.errors import ClusterError
from tissuereg.parallel.executor import Failed, Finished, outcome_of

#: More processes are a slip of the pen.
_MOST = 9999


class Processes(AbstractContextManager["Processes"]):
    """Runs tasks in processes of this machine, started afresh; they end with the process that made them.

    A process that dies ends the run, as nobody knows which task it was; where that must not be, use ``local:N``.

    Parameters
    ----------
    n : int
        How many.

    Raises
    ------
    ArgumentError
        If `n` is no whole number from 1 to 9999.
    """

    def __init__(self, n: int) -> None:
        whole("n", n, least=1, most=_MOST)
        self._n = n
        self._spent = 0.0
        # Solvers keep threads of their own: a forked process would hang.
        self._pool = ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), initializer=_follow_parent)

    def __exit__(self, *_: object) -> None:
        """Stop the processes; tasks that wait are dropped."""
        self._pool.shutdown(cancel_futures=True)

    @property
    def n_workers(self) -> int:
        """Number of processes."""
        return self._n

    @property
    def worker_seconds(self) -> float:
        """Wall time of all runs so far times processes, in s."""
        return self._spent

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Yield outcomes as they come; see `Executor.run`.

        Raises
        ------
        ClusterError
            If a process dies.
        """
        source, running = enumerate(tasks), set[Future[Finished | Failed]]()
        begun = time.perf_counter()
        try:
            while True:
                while len(running) < 2 * self._n and (following := next(source, None)) is not None:
                    running.add(self._pool.submit(outcome_of, function, *following))
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool as error:
            message = "a process must live until its tasks are done; one died. Run the same command again"
            raise ClusterError(message) from error
        finally:
            self._spent += self._n * (time.perf_counter() - begun)
            for future in running:
                future.cancel()


def _follow_parent() -> None:
    """Let this process end with Ctrl-C, and with the process that made it, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
