"""The recipe of the data on which the shipped model was trained."""

from importlib.resources import files
from pathlib import Path

from tissuereg.simulation.recipe import Recipe, read_recipe


def shipped_recipe() -> Recipe:
    """Return the recipe of the data on which the shipped model was trained.

    Returns
    -------
    Recipe
        That of ``training/recipes/breast.toml``: its mesh is ``phantom_mesh()``; its ``data`` and ``material`` are
        what `EventSampler` draws deformations of that body from.
    """
    return read_recipe(Path(str(files("tissuereg.phantom"))) / "data" / "breast.toml")
