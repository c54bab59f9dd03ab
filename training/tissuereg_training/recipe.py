"""Recipes: reading `[train]` and checking it."""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissuereg_training.errors import ExperimentError
from tissuereg_training.settings import SETTINGS, TrainSettings

#: What a recipe may hold at its top.
TOP_LEVEL = ("seed", "mesh", "material", "data", "pairs", "train")


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
    kind = given.get("kind", "graph")
    if not isinstance(kind, str) or kind not in SETTINGS:
        message = f"{place} kind must be one of {', '.join(SETTINGS)}, got {kind!r}"
        raise ExperimentError(message, where=f"{place} kind")
    defaults = SETTINGS[kind]().as_dict()
    unknown = sorted(set(given) - set(defaults))
    if unknown:
        message = f"{place} holds {', '.join(defaults)} and nothing else, got: {', '.join(unknown)}"
        raise ExperimentError(message, where=f"{place} {unknown[0]}")
    named = {key: value for key, value in given.items() if key != "kind"}
    settings = SETTINGS[kind](**{key: _value(f"{place} {key}", v, defaults[key]) for key, v in named.items()})
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
