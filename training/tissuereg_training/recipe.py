"""The `[train]` table of a recipe: what is trained, how long, and what the rest of the recipe must not contradict."""

import dataclasses
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissuereg_training.errors import ExperimentError
from tissuereg_training.graph import COARSE_HOPS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: What a recipe may hold at its top.
TOP_LEVEL = ("seed", "mesh", "material", "data", "pairs", "train")
LOSSES = ("distance", "squared")


@dataclass(frozen=True)
class TrainSettings:
    """The keys of `[train]`.

    Parameters
    ----------
    epochs : int
        Passes over the training split.
    batch : int
        Fields a step.
    learning_rate : float
        Peak of the one-cycle schedule.
    rise : float
        Share of all steps in which the learning rate rises to its peak; it falls to zero after.
    loss : {"distance", "squared"}
        Reconstruction term: mean Euclidean node error, or mean squared component; both in units of the scale.
    kl_weight : float
        Weight of the Kullback-Leibler divergence of q(z | x) from N(0, 1), summed over latents. Positive: a network
        without it has no prior.
    kl_warmup : float
        Share of the epochs in which that weight rises from zero; no epoch before its end can be chosen as the best.
    mixing : float
        Share of a batch's fields that are replaced by weighted sums with another training field, both weights uniform
        in [-1, 1]: fields that no load makes, but near enough to teach. For a few hundred members.
    n_latent : int
        Latents.
    channels : tuple of int
        Channels a level, finest first; as many poolings as entries.
    n_bases : int
        Basis matrices a convolution, M.
    coarse_edges : {"wide", "reduced"}
        Coarse nodes are neighbours within 3 hops of the finer graph, or within 2.
    gradient_limit : float
        Largest norm of the whole gradient; longer ones are shortened.
    """

    epochs: int = 300
    batch: int = 16
    learning_rate: float = 2e-3
    rise: float = 0.3
    loss: str = "distance"
    kl_weight: float = 1e-3
    kl_warmup: float = 0.3
    mixing: float = 0.0
    n_latent: int = 26
    channels: tuple[int, ...] = (32, 64, 128)
    n_bases: int = 9
    coarse_edges: str = "wide"
    gradient_limit: float = 1.0

    def rules(self) -> tuple[tuple[bool, str, str], ...]:
        """Return what must hold: (holds, key, sentence)."""
        return (
            (self.epochs >= 1, "epochs", "at least 1"),
            (self.batch >= 1, "batch", "at least 1"),
            (0 < self.learning_rate < 1, "learning_rate", "in (0, 1)"),
            (0 < self.rise < 1, "rise", "in (0, 1)"),
            (self.loss in LOSSES, "loss", f"one of {', '.join(LOSSES)}"),
            (0 < self.kl_weight < math.inf, "kl_weight", "positive: without it the codes have no prior"),
            (0 <= self.kl_warmup < 1, "kl_warmup", "in [0, 1)"),
            (0 <= self.mixing <= 1, "mixing", "in [0, 1]"),
            (self.n_latent >= 1, "n_latent", "at least 1"),
            (
                len(self.channels) >= 1 and min(self.channels, default=0) >= 1,
                "channels",
                "positive whole numbers",
            ),
            (self.n_bases >= 1, "n_bases", "at least 1"),
            (self.coarse_edges in COARSE_HOPS, "coarse_edges", f"one of {', '.join(COARSE_HOPS)}"),
            (self.gradient_limit > 0, "gradient_limit", "positive"),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the settings as plain data."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(self).items()}


@dataclass(frozen=True)
class Recipe:
    """A recipe as training reads it.

    Attributes
    ----------
    path : Path
        Where it was read.
    seed : int
        Of split, start and noise.
    settings : TrainSettings
        `[train]`.
    raw : dict
        The whole content of the file.
    """

    path: Path
    seed: int
    settings: TrainSettings
    raw: dict[str, Any]


def read_recipe(path: str | os.PathLike[str]) -> Recipe:
    """Read a recipe.

    Parameters
    ----------
    path : path-like
        A TOML file.

    Returns
    -------
    Recipe
        With defaults where the file is silent.

    Raises
    ------
    ExperimentError
        If the file is missing or no TOML, or a key is unknown or its value out of range.
    """
    path = Path(path)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        message = f"the recipe {path} must be a readable TOML file: {error}"
        raise ExperimentError(message, where=str(path)) from error
    unknown = sorted(set(raw) - set(TOP_LEVEL))
    if unknown:
        message = f"{path}: a recipe holds {', '.join(TOP_LEVEL)} and nothing else, got: {', '.join(unknown)}"
        raise ExperimentError(message, where=str(path))
    seed = raw.get("seed", 0)
    if type(seed) is not int or seed < 0:
        message = f"{path}: seed must be a whole number of at least 0, got {seed!r}"
        raise ExperimentError(message, where=f"{path}: seed")
    return Recipe(path, seed, _settings(path, raw.get("train", {})), raw)


def _settings(path: Path, given: Any) -> TrainSettings:
    place = f"{path}: [train]"
    if not isinstance(given, Mapping):
        message = f"{place} must be a table, got {given!r}"
        raise ExperimentError(message, where=place)
    defaults = TrainSettings().as_dict()
    unknown = sorted(set(given) - set(defaults))
    if unknown:
        message = f"{place} holds {', '.join(defaults)} and nothing else, got: {', '.join(unknown)}"
        raise ExperimentError(message, where=f"{place} {unknown[0]}")
    values = {key: _value(f"{place} {key}", value, defaults[key]) for key, value in given.items()}
    settings = TrainSettings(**values)
    for holds, key, sentence in settings.rules():
        if not holds:
            message = f"{place} {key} must be {sentence}, got {getattr(settings, key)!r}"
            raise ExperimentError(message, where=f"{place} {key}")
    return settings


def _value(place: str, value: Any, default: Any) -> Any:
    if isinstance(default, list):
        if isinstance(value, list) and all(type(v) is int for v in value):
            return tuple(value)
    elif isinstance(default, float):
        if type(value) in (int, float):
            return float(value)
    elif type(value) is type(default):
        return value
    message = f"{place} must be of the kind of {default!r}, got {value!r}"
    raise ExperimentError(message, where=place)
