"""Dask workers as jobs of a batch system, by dask-jobqueue, as a YAML file describes them."""

from pathlib import Path
from typing import Any

from tissuereg.errors import ClusterError, FormatError, MissingPackageError
from tissuereg.parallel.cluster import SETTINGS, Cluster, need_dask

#: Classes of dask-jobqueue by the file's ``kind``; ``local`` runs its jobs on this machine, to try a file out.
KINDS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
    "local": "LocalCluster",
}


def submitted(path: str, *, task_limit: float, patience: float) -> Cluster:
    """Return the executor over Dask workers that a batch system starts as jobs, as a YAML file describes them.

    `path`: file with ``kind`` (the batch system, default ``slurm``), ``workers`` (``minimum`` and ``maximum`` number)
    and ``job``, the arguments of dask-jobqueue's class; `task_limit`: time in s after which a task counts as hung;
    `patience`: time in s for which a scheduler that does not answer is tried again. The jobs end with the executor.
    Raises `FormatError` if the file cannot be read, or an entry is unknown or wrong; `MissingPackageError` if
    dask.distributed or dask-jobqueue is not installed; `ClusterError` if the scheduler does not start.
    """
    need_dask()
    kind, job, minimum, maximum = read_jobs(path)
    try:
        import dask_jobqueue
        from dask_jobqueue import local
    except ImportError as error:
        message = f"{path}: workers of a batch system need dask-jobqueue; `pip install dask-jobqueue`"
        raise MissingPackageError(message, where="dask_jobqueue") from error
    import dask

    cluster_of: Any = getattr(local if kind == "local" else dask_jobqueue, KINDS[kind])
    try:
        with dask.config.set(SETTINGS):
            cluster = cluster_of(**job)
            cluster.adapt(minimum=minimum, maximum=maximum)
    except (TypeError, ValueError) as error:
        message = f"{path}: `job` must hold arguments of dask-jobqueue's {KINDS[kind]}: {error}"
        raise FormatError(message, where=path) from error
    except (OSError, RuntimeError) as error:
        message = f"{path}: the scheduler for the jobs must start; it did not: {error}"
        raise ClusterError(message, where=path) from error
    return Cluster(cluster, path, task_limit=task_limit, patience=patience)


def read_jobs(path: str) -> tuple[str, dict[str, Any], int, int]:
    """Read the YAML file that describes the jobs in which a batch system starts Dask workers.

    `path`: file with ``kind``, ``workers`` and ``job``. Result: ``kind``, the batch system, one of `KINDS`; ``job``,
    the arguments of dask-jobqueue's class; least and largest number of workers. If ``job`` has a walltime and no
    lifetime, a lifetime is added by which workers leave before the walltime is over. Raises `FormatError` if the file
    cannot be read, or an entry is unknown or wrong.
    """
    import yaml

    if Path(path).exists() and not Path(path).is_file():
        message = f"{path} must be a regular YAML file; it is a folder, a pipe or a device"
        raise FormatError(message, where=path)
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        message = f"{path} must be a readable YAML file: {' '.join(str(error).split())}"
        raise FormatError(message, where=path) from error
    if not isinstance(content, dict) or set(content) - {"kind", "workers", "job"}:
        message = f"{path} must hold kind, workers and job alone; got {content if content is None else [*content]}"
        raise FormatError(message, where=path)
    kind, workers, job = content.get("kind", "slurm"), content.get("workers"), content.get("job")
    if kind not in KINDS:
        message = f"{path}: kind must be among {', '.join(KINDS)}; got {kind!r}"
        raise FormatError(message, where=f"{path}: kind")
    if not isinstance(job, dict) or not all(isinstance(key, str) for key in job):
        message = f"{path}: job must be a table of arguments of dask-jobqueue's {KINDS[kind]}; got {job!r}"
        raise FormatError(message, where=f"{path}: job")
    if not isinstance(workers, dict) or set(workers) - {"minimum", "maximum"} or "maximum" not in workers:
        message = f"{path}: workers must hold maximum, and may hold minimum; got {workers!r}"
        raise FormatError(message, where=f"{path}: workers")
    minimum, maximum = workers.get("minimum", 0), workers["maximum"]
    if not (type(minimum) is int and type(maximum) is int and 0 <= minimum <= maximum and maximum >= 1):
        message = f"{path}: workers must be whole numbers with 0 <= minimum <= maximum; got {workers!r}"
        raise FormatError(message, where=f"{path}: workers")
    return kind, _with_lifetime(path, job), minimum, maximum


def _with_lifetime(path: str, job: dict[str, Any]) -> dict[str, Any]:
    """Return a job's arguments with a lifetime of its workers of 90 % of the walltime, unless one is stated already."""
    extra = list(job.get("worker_extra_args", []))
    if "walltime" not in job or any(str(word).startswith("--lifetime") for word in extra):
        return job
    seconds = _seconds(path, job["walltime"])
    leave, stagger = int(0.9 * seconds), max(1, int(0.05 * seconds))
    return {**job, "worker_extra_args": [*extra, "--lifetime", f"{leave}s", "--lifetime-stagger", f"{stagger}s"]}


def _seconds(path: str, walltime: object) -> int:
    days, _, clock = walltime.rpartition("-") if isinstance(walltime, str) else ("", "", "")
    parts = clock.split(":")
    if not 2 <= len(parts) <= 3 or not all(part.isdigit() for part in [*parts, days or "0"]):
        message = f'{path}: walltime must be a text "[DAYS-]HOURS:MINUTES:SECONDS" in quotation marks; got {walltime!r}'
        raise FormatError(message, where=f"{path}: walltime")
    hours, minutes, seconds = [0, *map(int, parts)][-3:]
    return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + seconds
