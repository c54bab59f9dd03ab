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
    """Outcome of a task whose function has returned.

    Attributes
    ----------
    index : int
        Position of the task among all tasks, from 0.
    result : object
        The value that the function returned.
    """

    index: int
    result: Any


@dataclass(frozen=True)
class Failed:
    """Outcome of a task without a result; other tasks are not affected.

    Attributes
    ----------
    index : int
        Position of the task among all tasks, from 0.
    error : Exception
        The exception that the function raised, or a `ClusterError` if the task took too long or its worker died
        repeatedly.
    """

    index: int
    error: Exception


@runtime_checkable
class Executor(Protocol):
    """Protocol of objects that call one function on many tasks, in this process or in others."""

    @property
    def n_workers(self) -> int:
        """Number of tasks that can run at the same time now."""
        ...

    @property
    def worker_seconds(self) -> float:
        """Time in s, summed over workers, during which they were available to the tasks of all runs so far."""
        ...

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Call a function on every task, and yield one outcome per task in the order in which they finish.

        Parameters
        ----------
        function : callable
            Function of one task, defined at the top level of a module. It may be called again for the same task if a
            worker died, so a second call must do no harm.
        tasks : iterable
            Arguments of the function, one per call: small values that can be pickled. They are taken from the iterable
            as workers become free, never all at once.

        Yields
        ------
        Finished or Failed
            One outcome for each task, with the position of the task.

        Raises
        ------
        ClusterError
            If the workers, or the connection to them, are lost for good.
        """
        ...


class InProcess(AbstractContextManager["InProcess"]):
    """Executor that runs tasks one after another in this process."""

    def __init__(self) -> None:
        self._spent = 0.0

    def __exit__(self, *_: object) -> None:
        """Do nothing: there is nothing to close."""

    @property
    def n_workers(self) -> int:
        """Number of tasks that run at the same time: always 1."""
        return 1

    @property
    def worker_seconds(self) -> float:
        """Time in s, by the clock, that tasks of all runs so far have taken."""
        return self._spent

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Call `function` on each task in turn in this process, and yield one outcome per task, in their order."""
        for index, task in enumerate(tasks):
            start = time.perf_counter()
            outcome = outcome_of(function, index, task)
            self._spent += time.perf_counter() - start
            yield outcome


def outcome_of(function: Callable[[Any], Any], index: int, task: Any) -> Finished | Failed:
    """Call `function` on `task` here and now, and return the outcome, which carries the position `index` of the task.

    The outcome is `Finished` with the result, or `Failed` for any exception but an interrupt.
    """
    try:
        return Finished(index, function(task))
    except Exception as error:
        return Failed(index, error)


def in_order(
    outcomes: Iterable[Finished | Failed], progress: Callable[[int], None] | None = None
) -> Iterator[Finished | Failed]:
    """Yield the outcomes of a run in the order of their tasks, not in that in which they finish.

    Parameters
    ----------
    outcomes : iterable of Finished or Failed
        Outcomes in the order in which the tasks finish.
    progress : callable of int, optional
        Function that is called with the number of outcomes so far, each time one comes.

    Yields
    ------
    Finished or Failed
        Each outcome as soon as it and those of all earlier tasks have come.
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
    """Run a single task on an executor and return its result.

    Parameters
    ----------
    executor : Executor
        Executor on which it runs.
    function : callable
        Function of one task.
    task : object
        Argument of the function.

    Returns
    -------
    object
        The value that the function returned.

    Raises
    ------
    Exception
        The exception that the function raised.
    """
    (outcome,) = executor.run(function, [task])
    if isinstance(outcome, Failed):
        raise outcome.error
    return outcome.result


#: More processes are a slip of the pen.
_MOST = 9999


class Processes(AbstractContextManager["Processes"]):
    """Executor that runs tasks in newly started processes of this machine, which end with the process that made them.

    If one of the processes dies the run ends, because it is not known which task killed it. The executor of
    ``open_executor("local:N")`` goes on in that case.

    Parameters
    ----------
    n : int
        Number of processes.

    Raises
    ------
    ArgumentError
        If `n` is not a whole number from 1 to 9999.
    """

    def __init__(self, n: int) -> None:
        whole("n", n, least=1, most=_MOST)
        self._n = n
        self._spent = 0.0
        # Solvers keep threads of their own: a forked process would hang.
        self._pool = ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), initializer=_follow_parent)

    def __exit__(self, *_: object) -> None:
        """Stop the processes; tasks that have not begun are dropped."""
        self._pool.shutdown(cancel_futures=True)

    @property
    def n_workers(self) -> int:
        """Number of processes."""
        return self._n

    @property
    def worker_seconds(self) -> float:
        """Time in s of all runs so far by the clock, times the number of processes."""
        return self._spent

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Call `function` on every task in the processes; yield one outcome per task in the order in which they finish.

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
    """Make this process end on Ctrl-C, and when the process that made it ends for whatever reason."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
