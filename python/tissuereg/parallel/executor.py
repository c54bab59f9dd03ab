"""Executors run one function on many tasks, in this process or in others, and give their outcomes as they come."""

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
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from tissuereg._base.arguments import whole
from tissuereg.errors import ClusterError


@dataclass(frozen=True)
class Finished:
    """A task that has returned.

    Attributes
    ----------
    index : int
        Its place among the tasks, from 0.
    result : object
        What the function returned.
    """

    index: int
    result: Any


@dataclass(frozen=True)
class Failed:
    """A task without a result; the others go on.

    Attributes
    ----------
    index : int
        Its place among the tasks, from 0.
    error : Exception
        What the function raised, or a `ClusterError` if it took too long or its worker died again and again.
    """

    index: int
    error: Exception


@runtime_checkable
class Executor(Protocol):
    """Runs a function on many tasks."""

    @property
    def n_workers(self) -> int:
        """Tasks that run side by side now."""
        ...

    @property
    def worker_seconds(self) -> float:
        """Time that workers were there for the tasks of all runs so far, summed over workers, in s."""
        ...

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Yield the outcome of every task once, in the order in which they finish.

        Parameters
        ----------
        function : callable
            Of one task; defined at the top of a module. It may be called more than once for a task (a worker died),
            so a second call must do no harm.
        tasks : iterable
            Small values that can be pickled. They are taken as workers become free, never all at once.

        Yields
        ------
        Finished or Failed
            One for each task.

        Raises
        ------
        ClusterError
            If the cluster is lost for good.
        """
        ...


class InProcess(AbstractContextManager["InProcess"]):
    """Runs tasks one after another in this process."""

    def __init__(self) -> None:
        self._spent = 0.0

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""

    @property
    def n_workers(self) -> int:
        """Always 1."""
        return 1

    @property
    def worker_seconds(self) -> float:
        """Wall time of all runs so far in s."""
        return self._spent

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Yield the outcomes in the order of the tasks; see `Executor.run`."""
        for index, task in enumerate(tasks):
            start = time.perf_counter()
            outcome = outcome_of(function, index, task)
            self._spent += time.perf_counter() - start
            yield outcome


def outcome_of(function: Callable[[Any], Any], index: int, task: Any) -> Finished | Failed:
    """Return what became of a task that is run here and now.

    `function`: of one task; `index`: place of the task; `task`: the task. Result: failed for any exception but an
    interrupt.
    """
    try:
        return Finished(index, function(task))
    except Exception as error:
        return Failed(index, error)


def in_order(
    outcomes: Iterable[Finished | Failed], progress: Callable[[int], None] | None = None
) -> Iterator[Finished | Failed]:
    """Yield outcomes in the order of their tasks.

    Parameters
    ----------
    outcomes : iterable of Finished or Failed
        As they come.
    progress : callable of int, optional
        Called with the number of outcomes that have come.

    Yields
    ------
    Finished or Failed
        Each as soon as it and all before it are there.
    """
    waiting: dict[int, Finished | Failed] = {}
    following = 0
    for done, outcome in enumerate(outcomes, start=1):
        waiting[outcome.index] = outcome
        if progress is not None:
            progress(done)
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def one_result(executor: Executor, function: Callable[[Any], Any], task: Any) -> Any:
    """Return the result of a single task.

    Parameters
    ----------
    executor : Executor
        Where it runs.
    function : callable
        Of one task.
    task : object
        The task.

    Returns
    -------
    object
        What the function returned.

    Raises
    ------
    Exception
        What the function raised.
    """
    (outcome,) = executor.run(function, [task])
    if isinstance(outcome, Failed):
        raise outcome.error
    return outcome.result


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
