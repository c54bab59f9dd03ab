"""Many independent tasks: in this process, in processes of this machine, or on a Dask cluster.

The one place that makes processes and knows of Dask. The rest of the package takes an `Executor`.
"""

from tissuereg.parallel.executor import Executor, Failed, Finished, InProcess, in_order, one_result
from tissuereg.parallel.opening import open_executor
from tissuereg.parallel.processes import Processes

__all__ = ["Executor", "Failed", "Finished", "InProcess", "Processes", "in_order", "one_result", "open_executor"]
