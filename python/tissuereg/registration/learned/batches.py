"""Members of an ensemble in batches, and other tasks, on threads that are started once a process and kept."""

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray

#: Threads of this process beside the caller's, by process (a forked one has none of them) and number.
_HELPERS: dict[tuple[int, int], ThreadPoolExecutor] = {}


def in_batches(run: Callable[[npt.NDArray[np.float32]], Any], latents: FloatArray, most: int, threads: int) -> Any:
    """Return what `run` makes of all members, put together along the first axis.

    `run`: members (n_batch, n_latent), float32 and contiguous, to rows (n_batch, ...). Called by several threads at
    once; `latents` (n_latent, n_members): one column per member; `most`: members in a batch, at most; batches are of
    nearly one size, whatever the number of threads, so that the bits do not depend on it; `threads`: threads that run
    batches, the caller's included. Result: float32 (n_members, ...), in the order of the members.
    """
    rows = np.ascontiguousarray(latents.T, np.float32)
    count = -(-len(rows) // most)
    if count < 2:
        return run(rows)
    batches = np.array_split(rows, count)
    return np.concatenate(together([partial(run, batch) for batch in batches], threads))


def together(tasks: Sequence[Callable[[], Any]], threads: int) -> list[Any]:
    """Return what some tasks return, in their order, run by so many threads, the caller's included."""
    found: list[Any] = [None] * len(tasks)
    numbers = itertools.count()

    def work() -> None:
        # Numbers are handed out one by one: `next` of a count is atomic.
        while (number := next(numbers)) < len(tasks):
            found[number] = tasks[number]()

    helpers = min(threads, len(tasks)) - 1
    started = [_helpers(helpers).submit(work) for _ in range(helpers)]
    work()
    for one in started:
        one.result()
    return found


def _helpers(count: int) -> ThreadPoolExecutor:
    key = (os.getpid(), count)
    if key not in _HELPERS:
        _HELPERS[key] = ThreadPoolExecutor(count, thread_name_prefix="decoder")
    return _HELPERS[key]
