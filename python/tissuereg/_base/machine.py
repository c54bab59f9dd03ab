"""Description of the machine, its free memory and the versions of packages, recorded with every measurement."""

import contextlib
import ctypes
import math
import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from tissuereg.errors import ArgumentError

#: Packages whose versions are reported if they were imported.
_PACKAGES = ("scipy", "onnxruntime", "h5py", "matplotlib", "torch")

#: Name in the environment of the memory in GB (1e9 bytes) that a process may take, in place of what the system states.
LIMIT = "TISSUEREG_MEMORY_GB"


def peak_mib() -> float | None:
    """Return the peak memory of this process so far, in MiB (2^20 bytes); None if it is unknown."""
    try:
        import resource
    except ImportError:
        return None
    size = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return size / 2**20 if sys.platform == "darwin" else size / 2**10


def resident_bytes() -> int | None:
    """Return the physical memory that this process holds now, in bytes; None if it is unknown."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return None


def available_bytes() -> int | None:
    """Return the memory in bytes that this process may still take; None if it is unknown or without limit.

    If the environment variable ``TISSUEREG_MEMORY_GB`` is set, it is the total that the process may take, and the
    result is that total less what the process holds. Otherwise the result is the smallest of the memory that the system
    has without swapping (``MemAvailable``) and of what each control group of the process leaves of its limit. Raises
    `ArgumentError` if the variable is not a positive number of GB (1e9 bytes); ``inf`` means no limit.
    """
    stated = os.environ.get(LIMIT)
    if stated is not None:
        most = _positive(stated)
        return None if math.isinf(most) else max(0, int(1e9 * most) - (resident_bytes() or 0))
    known = [max(0, one) for one in (_system_left(), *_groups_left()) if one is not None]
    return min(known, default=None)


def _positive(stated: str) -> float:
    with contextlib.suppress(ValueError):
        number = float(stated)
        if number > 0.0:
            return number if number < 1e12 else math.inf
    message = f"{LIMIT} in the environment must be a positive number of GB, got {stated!r}"
    raise ArgumentError(message, where=LIMIT)


def _system_left() -> int | None:
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return None


def _groups_left(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> list[int]:
    """Return the bytes that each control group around this process has left of its limit, for versions 1 and 2.

    `root`: folder where the control groups are mounted; `own`: file that lists the groups of this process. Pages of
    files that the kernel caches but that are not in use count as free: the kernel drops them before it refuses memory.
    """
    found = []
    with contextlib.suppress(OSError):
        for line in own.read_text(encoding="utf-8").splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            names = (
                ("memory.limit_in_bytes", "memory.usage_in_bytes") if controllers else ("memory.max", "memory.current")
            )
            top = root / "memory" if controllers else root
            # A container sees its own group at the top, under whatever path the host gave it.
            for folder in [top / path.strip("/"), *(top / path.strip("/")).parents]:
                with contextlib.suppress(OSError, ValueError):
                    limit, used = (int((folder / name).read_text(encoding="ascii")) for name in names)
                    found.append(limit - used + _unused_pages(folder))
                if folder == top:
                    break
    return found


def _unused_pages(group: Path) -> int:
    with contextlib.suppress(OSError, ValueError):
        for line in (group / "memory.stat").read_text(encoding="ascii").splitlines():
            name, value = line.split()
            if name in ("total_inactive_file", "inactive_file"):
                return int(value)
    return 0


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> dict[str, Any]:
    """Return a description of the machine: ``system`` and ``processor`` as text, and ``cores``, the number usable."""
    return {"system": platform.platform(), "processor": _processor(), "cores": n_cores()}


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Return the versions of Python, tissuereg, numpy, and of each optional package that was imported, by name."""
    used = [name for name in _PACKAGES if name in sys.modules]
    versions = {"python": platform.python_version()}
    for name in ("tissuereg", "numpy", *used):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def give_back() -> None:
    """Give freed memory back to the system, where the C library can (glibc); each of its threads keeps some apart."""
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
