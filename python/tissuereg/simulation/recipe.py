"""The recipe of a data set and of the network trained on it: one TOML file.

``[mesh] [material] [data] [pairs]`` are read here, ``[train]`` by the training package.
"""

import os
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from tissuereg.body.mesh import Mesh
from tissuereg.errors import ExperimentError
from tissuereg.io.toml import read_toml
from tissuereg.simulation.variation import Variation

#: The embedded body in a recipe: as the source of meshes of any number of nodes.
PHANTOM = "phantom"

#: Its embedded meshes, by the names that stand for a file, and their sizes.
EMBEDDED = {PHANTOM: "full", "phantom-small": "small"}

#: Nodes of the mesh that a recipe makes if it states none: as many as the paper's breast phantom has.
DEFAULT_NODES = 4223


@dataclass(frozen=True)
class DataRecipe:
    """``[data]``: random events on the mesh.

    Parameters
    ----------
    members : int
        Simulations.
    chunk : int
        Simulations per file; at most this many are lost when a run is killed.
    element : str
        ``tet4`` or ``tet10``.
    largest_mm : tuple of float
        Range of an event's largest node displacement in the linear solution.
    n_patches : tuple of int
        Smallest and largest number of loaded patches.
    radius_mm : tuple of float
        Range of a patch's radius.
    body_force_share : float
        Probability of a body force beside patches or a plate.
    plate_share : float
        Probability that a flat plate of such a radius is pressed in, in place of patches.
    gravity_share : float
        Probability that there is a body force alone.
    most_mm : float
        A member that moves farther somewhere is solved again under a smaller load.
    """

    members: int = 300
    chunk: int = 250
    element: str = "tet4"
    largest_mm: tuple[float, float] = (2.0, 25.0)
    n_patches: tuple[int, int] = (1, 3)
    radius_mm: tuple[float, float] = (10.0, 40.0)
    body_force_share: float = 0.6
    plate_share: float = 0.0
    gravity_share: float = 0.0
    most_mm: float = 1e3


@dataclass(frozen=True)
class PairsRecipe:
    """``[pairs]``: the same event simulated by the believed model and by another model.

    Parameters
    ----------
    members : int
        Number of pairs.
    element : str
        Elements of the truth.
    young_log_std : float
        Standard deviation of the logarithm of Young's modulus, truth over believed.
    load_log_std : float
        Standard deviation of the logarithm of every load's size.
    load_tilt_deg : float
        Standard deviation of a load's rotation about each axis.
    inclusion_share : float
        Probability that the truth contains a stiff ball.
    inclusion_radius_mm : tuple of float
        Range of its radius.
    inclusion_contrast : tuple of float
        Range of its modulus over that around it.
    poisson_change : tuple of float
        Range of Poisson's ratio of the truth less that of the believed model.
    """

    members: int = 100
    element: str = "tet10"
    young_log_std: float = 0.25
    load_log_std: float = 0.10
    load_tilt_deg: float = 5.0
    inclusion_share: float = 0.7
    inclusion_radius_mm: tuple[float, float] = (6.0, 14.0)
    inclusion_contrast: tuple[float, float] = (1.5, 6.0)
    poisson_change: tuple[float, float] = (0.0, 0.0)

    @property
    def variation(self) -> Variation:
        """The spreads in the form of the sampler."""
        return Variation(self.young_log_std, self.load_log_std, self.load_tilt_deg)


@dataclass(frozen=True)
class MaterialRecipe:
    """``[material]``: stiffness, one for the whole body.

    Parameters
    ----------
    young_kpa : tuple of float
        Range of Young's modulus.
    poisson : float
        Poisson's ratio.
    """

    young_kpa: tuple[float, float] = (10.0, 60.0)
    poisson: float = 0.45


@dataclass(frozen=True)
class Recipe:
    """A whole recipe.

    Attributes
    ----------
    path : Path
        File it was read from.
    seed : int
        Seed of all random numbers.
    mesh_file : str or None
        ``phantom``, ``phantom-small``, or a mesh file relative to the recipe; None if the recipe makes its mesh.
    n_nodes : int or None
        Nodes of the mesh of the breast phantom that the recipe makes, about.
    fixed : str or None
        Plane of held nodes, if the mesh file has no such set.
    material, data, pairs
        The tables.
    raw : dict
        The whole content of the file, for the record.
    """

    path: Path
    seed: int
    mesh_file: str | None
    n_nodes: int | None
    fixed: str | None
    material: MaterialRecipe
    data: DataRecipe
    pairs: PairsRecipe
    raw: dict[str, Any] = field(default_factory=dict)

    def mesh(self) -> Mesh:
        """Return the mesh that the recipe names.

        Raises
        ------
        FormatError, MeshError
            If the file is missing or holds no usable mesh.
        """
        if self.mesh_file is None:
            from tissuereg.phantom.breast import breast_mesh

            return breast_mesh(self.n_nodes or DEFAULT_NODES)
        if self.mesh_file in EMBEDDED:
            from tissuereg.phantom import phantom_mesh

            return phantom_mesh(EMBEDDED[self.mesh_file])
        from tissuereg.io.meshes import read_mesh

        return read_mesh(self.path.parent / self.mesh_file, fixed=self.fixed)


def read_recipe(path: str | os.PathLike[str]) -> Recipe:
    """Read a recipe.

    Parameters
    ----------
    path : path-like
        A TOML file.

    Returns
    -------
    Recipe
        With defaults for missing keys.

    Raises
    ------
    ExperimentError
        If a table or key is unknown, or a value has the wrong type or is out of its range.
    """
    return recipe_of(read_toml(path).rest(), path)


def recipe_of(raw: dict[str, Any], path: str | os.PathLike[str]) -> Recipe:
    """Return a recipe from the content of its file.

    Parameters
    ----------
    raw : dict
        Content of the file.
    path : path-like
        The file, for messages and as the place of a mesh file.

    Returns
    -------
    Recipe
        With defaults for missing keys.

    Raises
    ------
    ExperimentError
        As `read_recipe`.
    """
    unknown = set(raw) - {"seed", "mesh", "material", "data", "pairs", "train"}
    if unknown:
        known = "seed, [mesh], [material], [data], [pairs], [train]"
        message = f"{path}: unknown entries {', '.join(sorted(unknown))}; a recipe has {known}"
        raise ExperimentError(message, where=str(path))
    mesh = _mesh_table(path, raw.get("mesh", {}))
    seed = raw.get("seed", 0)
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        message = f"{path}: seed must be a whole number of at least 0, got {seed!r}"
        raise ExperimentError(message, where=f"{path}: seed")
    recipe = Recipe(
        Path(path),
        seed,
        mesh.get("file"),
        mesh.get("n_nodes"),
        mesh.get("fixed"),
        _table(path, "material", raw.get("material", {}), MaterialRecipe),
        _table(path, "data", raw.get("data", {}), DataRecipe),
        _table(path, "pairs", raw.get("pairs", {}), PairsRecipe),
        raw,
    )
    _check(path, recipe)
    return recipe


def _mesh_table(path: Any, mesh: Any) -> dict[str, Any]:
    """Return the table of the mesh, checked: a file, or the body that a mesh is made for."""
    table = mesh if isinstance(mesh, dict) else {}
    is_file = isinstance(table.get("file"), str) and not set(table) - {"file", "fixed"}
    n_nodes = table.get("n_nodes", DEFAULT_NODES)
    is_made = table.get("source") == PHANTOM and not set(table) - {"source", "n_nodes"} and type(n_nodes) is int
    if is_file or is_made:
        return table
    message = (
        f'{path}: [mesh] must hold file = "phantom", "phantom-small" or a mesh file, and may hold '
        f'fixed = "plane nx ny nz d [tol]"; '
        f'or source = "phantom", and may then hold n_nodes = {DEFAULT_NODES}'
    )
    raise ExperimentError(message, where=f"{path}: [mesh]")


def _table(path: Any, name: str, given: Any, kind: Any) -> Any:
    """Return a table as its dataclass, each value with the type of its default."""
    defaults = {f.name: f.default for f in fields(kind)}
    if not isinstance(given, dict) or set(given) - set(defaults):
        extra = ", ".join(sorted(set(given) - set(defaults))) if isinstance(given, dict) else repr(given)
        message = f"{path}: [{name}] must hold only {', '.join(defaults)}; got {extra}"
        raise ExperimentError(message, where=f"{path}: [{name}]")
    return kind(**{key: _value(f"{path}: [{name}] {key}", value, defaults[key]) for key, value in given.items()})


def _value(place: str, value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        if isinstance(value, list) and len(value) == 2:
            low, high = (_value(place, v, default[0]) for v in value)
            if low <= high:
                return (low, high)
        message = f"{place} must be a range [low, high], got {value!r}"
        raise ExperimentError(message, where=place)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if isinstance(default, float) and number:
        return float(value)
    if type(value) is type(default):
        return value
    message = f"{place} must be of the kind of {default!r}, got {value!r}"
    raise ExperimentError(message, where=place)


def _check(path: Any, recipe: Recipe) -> None:
    data, pairs = recipe.data, recipe.pairs
    rules = (
        (data.members >= 1 and data.chunk >= 1, "[data] members and chunk must be at least 1"),
        (pairs.members >= 0, "[pairs] members must be at least 0"),
        (
            {data.element, pairs.element} <= {"tet4", "tet4-averaged", "tet10"},
            "element must be tet4, tet4-averaged or tet10",
        ),
        (
            data.largest_mm[0] > 0 and data.radius_mm[0] > 0,
            "[data] largest_mm and radius_mm must be positive",
        ),
        (data.most_mm >= data.largest_mm[1], "[data] most_mm must be at least the largest of largest_mm"),
        (data.n_patches[0] >= 1, "[data] n_patches must start at 1 or more"),
        (
            all(
                0 <= share <= 1
                for share in (data.body_force_share, data.plate_share, data.gravity_share, pairs.inclusion_share)
            ),
            "shares must lie in [0, 1]",
        ),
        (data.plate_share + data.gravity_share <= 1, "[data] plate_share and gravity_share must sum to at most 1"),
        (recipe.material.young_kpa[0] > 0, "[material] young_kpa must be positive"),
        (-1 < recipe.material.poisson < 0.5, "[material] poisson must lie in (-1, 0.5)"),
        (
            recipe.material.poisson + pairs.poisson_change[0] > -1
            and recipe.material.poisson + pairs.poisson_change[1] < 0.5,
            "[pairs] poisson_change must keep Poisson's ratio in (-1, 0.5)",
        ),
        (
            pairs.inclusion_contrast[0] > 0 and pairs.inclusion_radius_mm[0] > 0,
            "[pairs] inclusions must be positive",
        ),
        (
            min(pairs.young_log_std, pairs.load_log_std, pairs.load_tilt_deg) >= 0,
            "[pairs] spreads must not be negative",
        ),
    )
    for holds, rule in rules:
        if not holds:
            message = f"{path}: {rule}"
            raise ExperimentError(message, where=str(path))
