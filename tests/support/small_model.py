"""The graph network of the small phantom: a trained model that registers in a fraction of a second."""

from pathlib import Path

#: For ``phantom_mesh("small")``; ``make small-model`` makes it anew.
SMALL_MODEL = Path(__file__).resolve().parents[1] / "data" / "small-model"
