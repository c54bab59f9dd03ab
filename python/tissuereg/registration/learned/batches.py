"""Evaluation of an ensemble in batches, and of other tasks, on threads that a process starts once and keeps."""

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
    """Evaluate `run` on all ensemble members, a batch at a time, and return the results joined along the first axis.

    `run` takes a batch of latents (n_batch, n_latent), float32 and contiguous, and returns an array (n_batch, ...);
    several threads call it at once. `latents` (n_latent, n_members), dimensionless, has one column per member. `most`
    is the largest number of members in a batch. Batches are of nearly one size and, beyond one, even in number, which
    two threads share fairly; they do not depend on the number of threads, and so neither do the bits. `threads` is the
    number of threads that run batches, the caller's included. The result is float32, shape (n_members, ...), in the
    order of the members and in the unit of what `run` returns.
    """
    rows = np.ascontiguousarray(latents.T, np.float32)
    count = -(-len(rows) // most)
    if count < 2:
        return run(rows)
    batches = np.array_split(rows, count + count % 2)
    return np.concatenate(together([partial(run, batch) for batch in batches], threads))


def together(tasks: Sequence[Callable[[], Any]], threads: int) -> list[Any]:
    """Call `tasks`, functions without arguments, on up to `threads` threads; return their results in order."""
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
