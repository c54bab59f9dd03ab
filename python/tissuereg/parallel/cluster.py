"""The executor that runs tasks on the workers of a Dask scheduler.

Dask already runs a task again whose worker died. This module adds four rules: only a few tasks are in the scheduler at
a time; a task that hangs is stopped; a worker's death counts against a task only if the task ran there; the connection
to a lost scheduler is tried again.
"""

import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Any

from tissuereg.errors import ClusterError, MissingPackageError, TissueRegError
from tissuereg.parallel.executor import Failed, Finished

#: How often a task may begin. More means that it kills its workers.
MOST_STARTS = 6

#: How often a task may take too long.
MOST_HANGS = 2

#: How often a task runs again, at once, that raised an error which is not ours: a file system may recover.
_RETRIES = 2

#: Tasks in the scheduler at a time: twice the threads of the workers, and at least this many.
_LEAST_IN_FLIGHT = 256

#: Pause between looks at what is done, at what hangs, and at the number of workers, in s.
_PAUSE, _LOOKING, _COUNTING = 0.01, 0.2, 2.0

#: Time in s that a suspected task waits, so that the word of its start is out before it may kill its worker.
_SENDING = 0.2

#: Time in s for the scheduler to answer one question.
_ANSWER = 30.0

#: Time in s for a hung worker to end of itself before it is killed. Must be far below Dask's `lost-worker-timeout` of
#: 15 s, after which a local cluster gives up a worker that is not back.
_ENDING = 3.0

#: Settings of a scheduler that is started here. Whether a task kills its workers is decided in `Cluster`. Dask has
#: workers return freed memory at once, and factors then touch new pages again and again: here it is kept, by the
#: thresholds in bytes that glibc comes to by itself.
SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 5,
    "distributed.scheduler.worker-ttl": "60s",
    "distributed.nanny.pre-spawn-environ.RAYON_NUM_THREADS": 1,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 1 << 25,
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 1 << 26,
}


@dataclass
class _Job:
    """A task that has been taken from the list of tasks and has no outcome yet.

    `index`: position of the task among all tasks, from 0; `task`: the argument with which the function is called;
    `starts`, `hangs`: how often the task has begun in a worker, and how often it has exceeded the time limit;
    `suspected`: whether the scheduler gave the task up because workers died that ran it or had it in their queue;
    `started`: address of the worker in which it began last, and the time (monotonic clock, s) of that; None if it is
    not known to run; `future`: handle of the task in the scheduler; None before it is sent.
    """

    index: int
    task: Any
    starts: int = 0
    hangs: int = 0
    suspected: bool = False
    started: tuple[str, float] | None = None
    future: Any = None


class Cluster(AbstractContextManager["Cluster"]):
    """An executor that runs tasks on a Dask cluster; `tissuereg.parallel.open_executor` makes one.

    Parameters
    ----------
    where : object
        Address of a scheduler, or a cluster object of `distributed`, which is closed with the executor.
    name : str
        Name of the cluster in messages.
    task_limit : float
        Time in s after which a task counts as hung: its worker is restarted and the task runs again.
    patience : float
        Time in s for which a scheduler that does not answer is tried again.
    n_kept : int
        Number of workers to which a cluster object is scaled again when some are lost; with 0 nothing is done.

    Raises
    ------
    ClusterError
        If no scheduler answers.
    """

    def __init__(self, where: Any, name: str, *, task_limit: float, patience: float, n_kept: int = 0) -> None:
        self._where, self._name, self._n_kept = where, name, n_kept
        self._task_limit, self._patience = task_limit, patience
        self._spent = 0.0
        self._workers, self._counted, self._looked = 0, 0.0, 0.0
        self._topic = ""
        self._jobs: dict[str, _Job] = {}
        self._client = self._connected(min(10.0, patience))

    def __exit__(self, *_: object) -> None:
        """Disconnect from the scheduler; close the cluster if it is a cluster object rather than an address."""
        with suppress(Exception):
            self._client.close(timeout=5)
        if not isinstance(self._where, str):
            with suppress(Exception):
                self._where.close(timeout=10)

    @property
    def n_workers(self) -> int:
        """Number of threads of all workers that are connected now."""
        return sum(self._client.nthreads().values())

    @property
    def worker_seconds(self) -> float:
        """Time in s, summed over the threads of all workers, during which they were available to the runs so far."""
        return self._spent

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Finished | Failed]:
        """Call `function` on every task on the cluster; yield one outcome per task in the order in which they finish.

        Raises
        ------
        ClusterError
            If the scheduler is lost and does not answer again within the time `patience`.
        """
        source, waiting = enumerate(tasks), deque[_Job]()
        prefix = f"{getattr(function, '__name__', 'task')}-{uuid.uuid4().hex[:8]}"
        self._jobs, self._counted = {}, time.monotonic()
        n_sent = 0
        self._workers = self.n_workers
        try:
            while True:
                if self._client.status != "running":
                    waiting.extend(self._recovered())
                self._count()
                while len(self._jobs) < max(_LEAST_IN_FLIGHT, 2 * self._workers):
                    job = waiting.popleft() if waiting else _next_job(source)
                    if job is None:
                        break
                    key = f"{prefix}-{n_sent}"  # a task that is sent again is another one to the scheduler
                    n_sent += 1
                    self._send(job, key, function)
                if not self._jobs:
                    return
                done = [k for k, job in self._jobs.items() if job.future is None or job.future.status != "pending"]
                yield from self._collected(done, waiting)
                yield from self._stopped(waiting)
                if not done:
                    time.sleep(_PAUSE)
        finally:
            self._count(last=True)
            with suppress(Exception):
                self._client.cancel([job.future for job in self._jobs.values() if job.future is not None])
            self._jobs = {}

    def _send(self, job: _Job, key: str, function: Callable[[Any], Any]) -> None:
        self._jobs[key] = job
        job.started = None
        job.future = self._client.submit(
            _work, function, job.task, self._topic, key, job.suspected, key=key, retries=_RETRIES, pure=False
        )

    def _collected(self, done: list[str], waiting: "deque[_Job]") -> Iterator[Finished | Failed]:
        """Yield the outcomes of the tasks with the keys `done`; append tasks that must run again to `waiting`."""
        finished = {key: self._jobs[key].future for key in done if _status(self._jobs[key]) == "finished"}
        results: dict[str, Any] = {}
        if finished:
            with suppress(Exception):  # the scheduler or a worker is lost just now: seen at the next look
                results = self._client.sync(
                    lambda: self._client.gather(finished, errors="skip", asynchronous=True), callback_timeout=_ANSWER
                )
        for key in done:
            job = self._jobs[key]
            if (result := results.get(key)) is not None:
                del self._jobs[key]
                well, value = result
                yield Finished(job.index, value) if well else Failed(job.index, value)
            elif _status(job) == "error":
                del self._jobs[key]
                if not _died(error := _error(job)):
                    yield Failed(job.index, error)
                elif job.starts >= MOST_STARTS:
                    yield self._deadly(job)
                else:
                    job.suspected = True
                    waiting.append(job)
            elif _status(job) in ("cancelled", "lost"):
                waiting.append(self._jobs.pop(key))

    def _stopped(self, waiting: "deque[_Job]") -> Iterator[Failed]:
        """Restart the workers of tasks that hang; yield a failure for tasks that hang or kill their worker repeatedly.

        Other tasks that hang are appended to `waiting`, to run again.
        """
        now = time.monotonic()
        if now - self._looked < _LOOKING:
            return
        self._looked = now
        hung: dict[str, None] = {}
        late = self._late(now)
        for key, job in list(self._jobs.items()):
            if job.starts > MOST_STARTS:
                self._forget(key)
                yield self._deadly(job)
            elif key in late:
                hung[late[key]] = None
                job.hangs += 1
                job.started = None
                if job.hangs >= MOST_HANGS:
                    self._forget(key)
                    message = (
                        f"a task must end within {self._task_limit:g} s; task {job.index} did not, {job.hangs} times"
                    )
                    yield Failed(job.index, ClusterError(message, where=f"task {job.index}"))
                else:
                    job.starts -= 1
                    waiting.append(self._forget(key))
        if hung:
            with suppress(Exception):
                self._client.sync(
                    self._client.scheduler.restart_workers,
                    workers=[*hung],
                    timeout=_ENDING,
                    wait_for_workers=False,
                    on_error="return",
                    stimulus_id=f"task-limit-{time.time()}",
                    callback_timeout=2 * _ANSWER,
                )

    def _late(self, now: float) -> dict[str, str]:
        """Return the tasks that exceed the time limit on a connected worker: the worker's address by the task's key.

        `now`: monotonic time in s. A task whose worker has died is no longer marked as running: it waits for another
        worker, which may take long to start.
        """
        begun = {key: job.started for key, job in self._jobs.items() if job.started is not None}
        late = {key: worker for key, (worker, since) in begun.items() if now - since > self._task_limit}
        if not late:
            return {}
        try:
            there = self._client.nthreads()
        except Exception:  # nobody answers: nothing is known to hang
            return {}
        for key in [key for key, worker in late.items() if worker not in there]:
            del late[key]
            if self._jobs[key].started == begun[key]:  # it may have begun elsewhere meanwhile
                self._jobs[key].started = None
        return late

    def _forget(self, key: str) -> _Job:
        job = self._jobs.pop(key)
        with suppress(Exception):
            self._client.cancel([job.future])
        return job

    def _deadly(self, job: _Job) -> Failed:
        message = f"a worker must live through its task; the one of task {job.index} died, {job.starts} times"
        return Failed(job.index, ClusterError(message, where=f"task {job.index}"))

    def _recovered(self) -> list[_Job]:
        """Connect to the scheduler again, and return the tasks it had without an outcome, or raise ClusterError."""
        jobs, self._jobs = list(self._jobs.values()), {}
        with suppress(Exception):
            self._client.close(timeout=2)
        if not isinstance(self._where, str):
            message = f"the scheduler of {self._name} must live; it is gone. Run the same command again"
            raise ClusterError(message, where=self._name)
        self._client = self._connected(self._patience)
        return jobs

    def _connected(self, patience: float) -> Any:
        import distributed

        client_of: Any = distributed.Client
        until = time.monotonic() + patience
        while True:
            try:
                left = max(1.0, until - time.monotonic())
                client = client_of(self._where, timeout=left, set_as_default=False)
                break
            except (OSError, TimeoutError, ValueError) as error:
                if time.monotonic() >= until:
                    message = (
                        f"a Dask scheduler must answer at {self._name}; none did in {patience:g} s: "
                        f"{str(error) or type(error).__name__}. Run the same command again once it does"
                    )
                    raise ClusterError(message, where=self._name) from error
                time.sleep(0.2)
        self._topic = f"tissuereg-{uuid.uuid4().hex}"
        client.subscribe_topic(self._topic, self._note)
        return client

    def _note(self, event: tuple[float, dict[str, str]]) -> None:
        """Record that a worker has begun a task; `event` is Dask's (time, message); runs in the client's thread."""
        job = self._jobs.get(event[1]["key"])
        if job is not None:
            job.started = (event[1]["worker"], time.monotonic())
            job.starts += 1

    def _count(self, *, last: bool = False) -> None:
        """Add the time since the last call, times the workers, to the worker seconds; restart lost workers."""
        now = time.monotonic()
        if last or now - self._counted > _COUNTING:
            before = self._workers
            if self._client.status == "running":
                with suppress(Exception):
                    self._workers = self.n_workers
            self._spent += (now - self._counted) * max(before, self._workers)
            self._counted = now
            if not last and self._workers < self._n_kept:
                with suppress(Exception):
                    self._where.scale(self._n_kept)  # starts those again that Dask has given up


def reach(address: str, *, task_limit: float, patience: float) -> Cluster:
    """Return the executor over a Dask scheduler that runs already.

    `address`: ``tcp://HOST:PORT``; `task_limit`: time in s after which a task counts as hung; `patience`: time in s for
    which a scheduler that does not answer is tried again. Raises `MissingPackageError` if dask.distributed is not
    installed; `ClusterError` if nothing answers.
    """
    need_dask()
    return Cluster(address, address, task_limit=task_limit, patience=patience)


def local(n: int, *, task_limit: float, patience: float) -> Cluster:
    """Start `n` worker processes on this machine, one thread each, and return the executor over them.

    `task_limit`: time in s after which a task counts as hung; `patience`: time in s for which a scheduler that does not
    answer is tried again. The processes end with the executor, and with this process. Raises `MissingPackageError` if
    dask.distributed is not installed; `ClusterError` if the processes do not start.
    """
    need_dask()
    import logging

    import dask
    import distributed

    local_cluster: Any = distributed.LocalCluster
    with dask.config.set(SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Port .* is already in use")
        try:
            cluster = local_cluster(
                n_workers=n,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,  # nothing is kept in workers; a limit would only stop them
                silence_logs=logging.CRITICAL,
            )
        except (OSError, TimeoutError, RuntimeError) as error:
            message = f"{n} worker processes must start on this machine; they did not: {error}"
            raise ClusterError(message, where=f"local:{n}") from error
    return Cluster(cluster, f"local:{n}", task_limit=task_limit, patience=patience, n_kept=n)


def need_dask() -> None:
    """Raise MissingPackageError where dask.distributed is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        message = "a cluster needs dask.distributed, which is not installed; `pip install 'tissuereg[cluster]'`"
        raise MissingPackageError(message, where="distributed") from error


def _work(function: Callable[[Any], Any], task: Any, topic: str, key: str, suspected: bool) -> tuple[bool, Any]:
    """Run a task in a Dask worker; return (True, result), or (False, error) for an error of this package.

    Any other error is raised, so that Dask tries again. The start is logged under `topic` with the task's `key`; a task
    that is `suspected` of killing workers waits a little after that.
    """
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(topic, {"key": key, "worker": worker.address})
    if suspected:
        time.sleep(_SENDING)
    try:
        return True, function(task)
    except TissueRegError as error:
        return False, error


def _next_job(source: Iterator[tuple[int, Any]]) -> _Job | None:
    following = next(source, None)
    return None if following is None else _Job(*following)


def _status(job: _Job) -> str:
    return "lost" if job.future is None else str(job.future.status)


def _error(job: _Job) -> Exception:
    try:
        error = None if job.future is None else job.future.exception(timeout=_ANSWER)
    except Exception as unreadable:
        error = unreadable
    return error if isinstance(error, Exception) else ClusterError(f"task {job.index} failed: {error}")


def _died(error: Exception) -> bool:
    from distributed import KilledWorker

    return isinstance(error, KilledWorker)
