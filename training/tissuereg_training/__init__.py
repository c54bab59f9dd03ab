"""Train the graph network behind tissuereg and export it to ONNX.

``train(recipe, data, out)`` does it all; ``python -m tissuereg_training`` and ``tissuereg train`` are its commands.
"""

import os
from typing import Any

from tissuereg_training.errors import TissueRegError

# Read when torch is loaded. A step is some hundred short parallel regions. Threads that spin between them for long (the
# default) make it forty times slower on a machine with other work; threads that sleep at once gain nothing from a
# second core. A short spin costs 8 % on an idle machine and a factor of three or four on a busy one.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")


def train(*args: Any, **settings: Any) -> dict[str, Any]:
    """Train and export; see `tissuereg_training.pipeline.train`, which is loaded (and torch with it) when called."""
    from tissuereg_training.pipeline import train as run

    return run(*args, **settings)


__all__ = ["TissueRegError", "train"]
