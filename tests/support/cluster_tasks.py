"""Tasks that harm their worker, run by workers that are real processes."""

import os
import signal
import time
from pathlib import Path

from tissuereg.errors import MaterialError
from tissuereg.parallel import Executor
from tissuereg.simulation.chunks import make_one_chunk


def first_time(flag: Path) -> bool:
    """Return whether nobody has asked for this flag before."""
    try:
        flag.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def square(task):
    """Return the square of a number, and leave a line that says that it was made; harm the worker as asked.

    A task is (folder, number, what): what is None, a signal's number that the worker sends itself once, ``always``
    (SIGKILL every time), ``loop`` (hang once in a living process), ``ours`` or ``other`` (raise), ``flaky`` (raise
    once).
    """
    folder, number, what = task
    flag = Path(folder) / f"flag-{number}"
    if what == signal.SIGSTOP:
        time.sleep(0.3)  # word of the start gets out; a worker that stops before it is found by its missing heartbeat
    if what == "always" or (isinstance(what, int) and first_time(flag)):
        os.kill(os.getpid(), signal.SIGKILL if what == "always" else what)
    if what == "loop" and first_time(flag):
        time.sleep(1000)
    if what == "ours":
        message = f"task {number} must not be made"
        raise MaterialError(message, where="here")
    if what == "other" or (what == "flaky" and first_time(flag)):
        message = f"task {number}"
        raise OSError(message)
    time.sleep(0.02)
    with (Path(folder) / "made").open("a") as made:
        made.write(f"{number}\n")
    return number**2


def harmed_chunk(task):
    """Make a chunk; in the middle of the second one, the worker sends itself a signal, once."""
    folder, number, chunk = task

    def progress(done):
        if chunk.number == 1 and done >= 1 and first_time(Path(folder) / "flag"):
            os.kill(os.getpid(), number)

    return make_one_chunk(chunk, progress)


class Harming:
    """An executor whose second chunk harms its worker."""

    def __init__(self, inner: Executor, folder: Path, number: int):
        self._inner, self._folder, self._number = inner, folder, number

    @property
    def n_workers(self):
        return self._inner.n_workers

    @property
    def worker_seconds(self):
        return self._inner.worker_seconds

    def run(self, function, tasks):
        assert function is make_one_chunk
        return self._inner.run(harmed_chunk, ((str(self._folder), self._number, task) for task in tasks))
