"""What this runs on, for the record beside every measured number."""

import contextlib
import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

#: Packages whose versions are told, where they were used.
_PACKAGES = ("scipy", "onnxruntime", "meshio", "trimesh", "matplotlib", "torch")


def peak_mib() -> float | None:
    """Return the largest memory that this process has held, in MiB; None where nobody knows."""
    try:
        import resource
    except ImportError:
        return None
    size = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return size / 2**20 if sys.platform == "darwin" else size / 2**10


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> dict[str, Any]:
    """Return what this runs on: ``system``, ``processor``, ``cores``."""
    return {"system": platform.platform(), "processor": _processor(), "cores": n_cores()}


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Return the versions of Python, tissuereg, numpy and whatever else has been imported so far."""
    used = [name for name in _PACKAGES if name in sys.modules]
    versions = {"python": platform.python_version()}
    for name in ("tissuereg", "numpy", *used):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
