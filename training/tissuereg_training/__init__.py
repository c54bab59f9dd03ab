"""Train the graph network behind tissuereg and export it to ONNX.

``train(recipe, data, out)`` does it all; ``python -m tissuereg_training`` and ``tissuereg train`` are its commands.
"""

from typing import Any

from tissuereg_training.errors import TissueRegError


def train(*args: Any, **settings: Any) -> dict[str, Any]:
    """Train and export; see `tissuereg_training.pipeline.train`, which is loaded (and torch with it) when called."""
    from tissuereg_training.pipeline import train as run

    return run(*args, **settings)


__all__ = ["TissueRegError", "train"]
