"""The recipe of data on the full body, for models of the paper's size."""

from importlib.resources import files
from pathlib import Path

from tissuereg.simulate.recipe import Recipe, read_recipe


def shipped_recipe() -> Recipe:
    """Return the recipe of 10,000 deformations of the full body.

    Returns
    -------
    Recipe
        That of ``training/recipes/breast.toml``: its mesh is ``phantom_mesh("full")``; its ``data`` and ``material`` are
        what `EventSampler` draws deformations of that body from.
    """
    return read_recipe(Path(str(files("tissuereg.phantom"))) / "data" / "breast.toml")
