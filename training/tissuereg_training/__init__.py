"""Train the graph network behind tissuereg and export it to ONNX.

``train(recipe, data, out)`` does it all; ``python -m tissuereg_training`` and ``tissuereg train`` are its commands.
"""

import os
from typing import Any

from tissuereg_training.errors import TissueRegError

# Read when torch is loaded. A step is some hundred short parallel regions; threads that wait by spinning make it
# ten times slower on a machine that has other work, and hardly faster on one that has none.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def train(*args: Any, **settings: Any) -> dict[str, Any]:
    """Train and export; see `tissuereg_training.pipeline.train`, which is loaded (and torch with it) when called."""
    from tissuereg_training.pipeline import train as run

    return run(*args, **settings)


__all__ = ["TissueRegError", "train"]
