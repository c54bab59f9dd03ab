"""What training runs on: threads, memory habits, and the record of machine and versions."""

import contextlib
import ctypes
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

_PACKAGES = ("tissuereg-training", "torch", "onnx", "onnxruntime", "numpy", "scipy")
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def prepare(threads: int) -> int:
    """Set torch's threads and keep freed memory with the process.

    Parameters
    ----------
    threads : int
        0 takes all cores.

    Returns
    -------
    int
        Threads in use.

    Notes
    -----
    A step allocates and frees some 50 MB in blocks of megabytes; glibc gives each back to the system and faults it in
    again, 2,500 page faults a step. Elsewhere than on glibc nothing is done.
    """
    threads = threads or n_cores()
    torch.set_num_threads(threads)
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, 2**30)
        libc.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
    return threads


def best_device() -> torch.device:
    """Return the graphics card where torch can use one, the processor otherwise."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def device_name(device: torch.device) -> str:
    """Return what a model card calls a device."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else "the processor"


def machine() -> dict[str, Any]:
    """Return what this runs on: ``system``, ``processor``, ``cores``."""
    processor = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
                break
    return {"system": platform.platform(), "processor": processor, "cores": n_cores()}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that training rests on."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


class Clock:
    """Wall time per stage, in `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block, also when it raises."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
