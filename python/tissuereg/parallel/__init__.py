"""Runs of many independent tasks: in this process, in processes of this machine, or on a Dask cluster.

Processes are made, and Dask is used, in this package alone. The rest of `tissuereg` takes an `Executor`.
"""

import re
from typing import TYPE_CHECKING

from tissuereg._base.arguments import real, text
from tissuereg.errors import ArgumentError
from tissuereg.parallel.executor import Executor, Failed, Finished, InProcess, Processes, in_order, one_result

if TYPE_CHECKING:
    from tissuereg.parallel.cluster import Cluster


__all__ = [
    "TASK_LIMIT",
    "Executor",
    "Failed",
    "Finished",
    "InProcess",
    "Processes",
    "in_order",
    "one_result",
    "open_executor",
]

#: Time in s after which a task counts as hung: far more than a chunk takes.
TASK_LIMIT = 900.0


def open_executor(address: str, *, task_limit: float = TASK_LIMIT, patience: float = 60.0) -> "Cluster":
    """Open a Dask cluster by its address and return an executor of tasks on it, to be used in a ``with`` block.

    Parameters
    ----------
    address : str
        ``tcp://HOST:PORT`` (or ``tls://``) of a scheduler that runs already; ``local:N`` for N processes of this
        machine, one thread each; or the path of a ``.yaml`` file that states which jobs to submit to a batch system
        (``docs/cluster.md``). A script that opens ``local:N`` needs ``if __name__ == "__main__":``.
    task_limit : float
        Time in s after which a task counts as hung: its worker is restarted and the task runs again.
    patience : float
        Time in s for which a scheduler that does not answer is tried again.

    Returns
    -------
    Cluster
        An open `Executor`: its method `run` calls a function on many tasks.

    Raises
    ------
    ArgumentError
        If the address has none of these forms, or a number is out of its range.
    FormatError
        If the ``.yaml`` file cannot be read, or an entry is unknown or wrong.
    MissingPackageError
        If dask.distributed, or dask-jobqueue for a file, is not installed.
    ClusterError
        If nothing answers at the address.
    """
    text("address", address)
    real("task_limit", task_limit, above=0.0)
    real("patience", patience, above=0.0)
    if re.fullmatch(r"(tcp|tls)://[^\s/:]+:\d{1,5}|(tcp|tls)://\[[0-9a-fA-F:.]+\]:\d{1,5}", address):
        from tissuereg.parallel.cluster import reach

        return reach(address, task_limit=task_limit, patience=patience)
    if re.fullmatch(r"local:[1-9]\d{0,3}", address):
        from tissuereg.parallel.cluster import local

        return local(int(address.partition(":")[2]), task_limit=task_limit, patience=patience)
    if address.endswith((".yaml", ".yml")):
        from tissuereg.parallel.jobs import submitted

        return submitted(address, task_limit=task_limit, patience=patience)
    message = f"a cluster must be tcp://HOST:PORT, local:N with N from 1 to 9999, or FILE.yaml; got {address!r}"
    raise ArgumentError(message, where="cluster")
