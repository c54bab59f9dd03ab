"""The recipe of a training data set and of the network trained on it: one TOML file.

The tables ``[mesh] [material] [data] [pairs]`` are read here, ``[train]`` by the training package.
"""

import os
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tissuereg._base import arguments
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import ELEMENTS, Element, Size
from tissuereg._base.fields import choice, number, span, text, whole
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.io.node_rules import node_rule
from tissuereg.io.toml import Keys, Table, read_toml


@dataclass(frozen=True)
class Variation:
    """Standard deviations of random variations of a load and of Young's modulus.

    Parameters
    ----------
    young_log_std : float
        Standard deviation of the natural logarithm of a factor on Young's modulus.
    load_log_std : float
        Standard deviation of the natural logarithm of a factor on the size of every load.
    load_tilt_deg : float
        Standard deviation of a load's rotation about each axis, in degrees.
    motion_log_std, motion_tilt_deg : float
        The corresponding two for prescribed displacements: logarithm of the factor, and rotation in degrees.
    """

    young_log_std: float = 0.25
    load_log_std: float = 0.05
    load_tilt_deg: float = 3.0
    motion_log_std: float = 0.03
    motion_tilt_deg: float = 2.0

    def draw(self, load: Load, material: Material, rng: np.random.Generator) -> tuple[Load, Material]:
        """Return one random variation of a load and a material.

        Parameters
        ----------
        load : Load
            The load to be varied, as the user believes it to be.
        material : Material
            The material to be varied, as the user believes it to be.
        rng : numpy.random.Generator
            Source of random numbers; the same numbers are drawn whatever the load holds.

        Returns
        -------
        load, material : Load, Material
            The load with its nodal forces, body force, traction and prescribed displacements each rotated and scaled
            independently, and the material with Young's modulus multiplied by one random factor.
        """
        softer = float(np.exp(self.young_log_std * rng.standard_normal()))
        force, weight, pull = (_turn(rng, self.load_log_std, self.load_tilt_deg) for _ in range(3))
        push = _turn(rng, self.motion_log_std, self.motion_tilt_deg)
        varied = Load(
            None if load.forces is None else np.asarray(load.forces, np.float64) @ force.T,
            None if load.body_force is None else weight @ np.asarray(load.body_force, np.float64),
            None if load.prescribed is None else np.asarray(load.prescribed, np.float64) @ push.T,
            None if load.traction is None else (load.traction[0], np.asarray(load.traction[1], np.float64) @ pull.T),
        )
        return varied, material.scaled(softer)


def _turn(rng: np.random.Generator, log_std: float, tilt_deg: float) -> FloatArray:
    """Return a small random rotation matrix times a random factor near one, shape (3, 3), dimensionless.

    `log_std`: standard deviation of the factor's logarithm; `tilt_deg`: that of the rotation about each axis, degrees.
    """
    from scipy.spatial.transform import Rotation

    vector = np.deg2rad(tilt_deg) * rng.standard_normal(3)
    return np.asarray(Rotation.from_rotvec(vector).as_matrix() * np.exp(log_std * rng.standard_normal()))


def random_inclusion(
    mesh: Mesh, rng: np.random.Generator, radius: tuple[float, float], contrast: tuple[float, float]
) -> FloatArray:
    """Return a factor on Young's modulus for every tet that differs from 1 inside a ball around a random node.

    `mesh`: reference shape; `rng`: source of random numbers; `radius`: smallest and largest radius of the ball in mm;
    `contrast`: smallest and largest ratio of the modulus inside to that outside; both are drawn uniformly. Result:
    (n_tets,), the drawn ratio where a tet's centre lies in the ball, 1 elsewhere.
    """
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    centre = mesh.nodes[rng.integers(mesh.n_nodes)]
    size, factor = rng.uniform(*radius), rng.uniform(*contrast)
    return np.where(np.linalg.norm(centres - centre, axis=1) <= size, factor, 1.0)


#: The embedded body in a recipe: as the source of meshes of any number of nodes.
PHANTOM = "phantom"

#: Its embedded meshes, by the names that stand for a file, and their sizes.
EMBEDDED: dict[str, Size] = {PHANTOM: "full", "phantom-small": "small"}

#: Nodes of the mesh that a recipe makes if it states none: as many as the paper's breast phantom has.
DEFAULT_NODES = 4223


@dataclass(frozen=True, kw_only=True)
class MeshRecipe(Keys):
    """The mesh of the body: a mesh file, or one that the recipe makes for the breast phantom of this package."""

    heading: ClassVar[str] = "[mesh]"
    needed: ClassVar[bool] = True
    file: str | None = text(
        "mesh file, seen from the recipe; or an embedded one, phantom or phantom-small", default=None, otherwise="none"
    )
    fixed: str | dict[str, Any] | None = node_rule(
        "of a file: the held nodes", default=None, otherwise="its node set `fixed`"
    )
    source: str | None = choice((PHANTOM,), "or: the body that a mesh is made for", default=None, otherwise="none")
    n_nodes: int | None = whole("of that mesh: nodes, about", least=1, default=None, otherwise=f"{DEFAULT_NODES}")

    def check(self) -> None:
        """Refuse neither or both of `file` and `source`, `fixed` without `file`, and `n_nodes` without `source`."""
        if (self.file is None) == (self.source is None):
            self.refuse("either `file` or `source` must be given")
        if (self.fixed if self.file is None else self.n_nodes) is not None:
            self.refuse("`fixed` must come with `file`, `n_nodes` with `source`")


@dataclass(frozen=True, kw_only=True)
class MaterialRecipe(Keys):
    """The elastic moduli of the simulated bodies; each simulation has one value for the whole body."""

    heading: ClassVar[str] = "[material]"
    young_kpa: tuple[float, float] = span("range of Young's modulus", above=0.0, default=(10.0, 60.0))
    poisson: float = number("Poisson's ratio", above=-1.0, below=0.5, default=0.45)


@dataclass(frozen=True, kw_only=True)
class DataRecipe(Keys):
    """The simulations of the data set: random loads on the mesh, their number, size and composition."""

    heading: ClassVar[str] = "[data]"
    members: int = whole("simulations", least=1, default=300)
    chunk: int = whole("simulations per file; at most this many are lost when a run is killed", least=1, default=250)
    element: Element = choice(ELEMENTS, "elements of the simulations", default="tet4")
    largest_mm: tuple[float, float] = span(
        "range of an event's largest node displacement in the linear solution", above=0.0, default=(2.0, 25.0)
    )
    n_patches: tuple[int, int] = span("smallest and largest number of loaded patches", counted=1, default=(1, 3))
    radius_mm: tuple[float, float] = span("range of a patch's radius", above=0.0, default=(10.0, 40.0))
    body_force_share: float = number(
        "probability of a body force beside patches or a plate", least=0.0, most=1.0, default=0.6
    )
    plate_share: float = number(
        "probability that a flat plate of such a radius is pressed in, in place of patches",
        least=0.0,
        most=1.0,
        default=0.0,
    )
    gravity_share: float = number("probability that there is a body force alone", least=0.0, most=1.0, default=0.0)
    most_mm: float = number(
        "a member that moves farther somewhere is solved again under a smaller load", above=0.0, default=1e3
    )

    def check(self) -> None:
        """Refuse a `most_mm` below the upper end of `largest_mm`, and plate and gravity shares whose sum exceeds 1."""
        if self.most_mm < self.largest_mm[1]:
            self.refuse("`most_mm` must be at least the largest of `largest_mm`", self.most_mm)
        if self.plate_share + self.gravity_share > 1.0:
            self.refuse(
                "`plate_share` and `gravity_share` must sum to at most 1", [self.plate_share, self.gravity_share]
            )


@dataclass(frozen=True, kw_only=True)
class PairsRecipe(Keys):
    """Pairs of simulations of one random event: by the assumed (believed) model, and by a varied one, the truth."""

    heading: ClassVar[str] = "[pairs]"
    members: int = whole("number of pairs", default=100)
    element: Element = choice(ELEMENTS, "elements of the truth", default="tet10")
    young_log_std: float = number(
        "standard deviation of the logarithm of Young's modulus, truth over believed", least=0.0, default=0.25
    )
    load_log_std: float = number("standard deviation of the logarithm of every load's size", least=0.0, default=0.10)
    load_tilt_deg: float = number("standard deviation of a load's rotation about each axis", least=0.0, default=5.0)
    inclusion_share: float = number(
        "probability that the truth contains a stiff ball", least=0.0, most=1.0, default=0.7
    )
    inclusion_radius_mm: tuple[float, float] = span("range of its radius", above=0.0, default=(6.0, 14.0))
    inclusion_contrast: tuple[float, float] = span(
        "range of its modulus over that around it", above=0.0, default=(1.5, 6.0)
    )
    poisson_change: tuple[float, float] = span(
        "range of Poisson's ratio of the truth less that of the believed model", default=(0.0, 0.0)
    )

    @property
    def variation(self) -> Variation:
        """The standard deviations by which Young's modulus and load of the truth differ from the believed ones."""
        return Variation(self.young_log_std, self.load_log_std, self.load_tilt_deg)


@dataclass(frozen=True)
class Recipe:
    """The content of a recipe file: mesh, material, random loads and pairs of a training data set.

    Attributes
    ----------
    path : Path
        File from which it was read.
    seed : int
        Seed of all random numbers.
    mesh_file : str or None
        ``phantom``, ``phantom-small``, or a mesh file relative to the recipe; None if the recipe makes its mesh.
    n_nodes : int or None
        Approximate number of nodes of the mesh of the breast phantom that the recipe makes; None for the default.
    fixed : str, dict or None
        Rule that selects the held nodes; None if the mesh file's own node set ``fixed`` is used.
    material : MaterialRecipe
        Table ``[material]``: range of Young's modulus in kPa, and Poisson's ratio.
    data : DataRecipe
        Table ``[data]``: number of simulations and their random loads.
    pairs : PairsRecipe
        Table ``[pairs]``: number of pairs, and how the second model of a pair differs.
    raw : dict
        The whole content of the file, for the record.
    """

    path: Path
    seed: int
    mesh_file: str | None
    n_nodes: int | None
    fixed: str | dict[str, Any] | None
    material: MaterialRecipe
    data: DataRecipe
    pairs: PairsRecipe
    raw: dict[str, Any] = field(default_factory=dict)

    def mesh(self) -> Mesh:
        """Return the mesh that the recipe names: read from a file, taken from the package, or newly made.

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
    """Read the recipe of a training data set from a TOML file.

    `path`: the file. Result: the recipe, with defaults for missing keys. Raises `ExperimentError` if a table or key is
    unknown, or a value has the wrong type or is out of its range.
    """
    return recipe_of(read_toml(path).rest(), path)


def recipe_of(raw: dict[str, Any], path: str | os.PathLike[str]) -> Recipe:
    """Return the recipe of a training data set from the content of its TOML file.

    `raw`: content of the file; `path`: the file, for messages and as the place to which a mesh file is relative.
    Result: the recipe, with defaults for missing keys. Raises `ExperimentError` if a table or key is unknown, or a
    value has the wrong type or is out of its range.
    """
    top = Table(Path(path), "", raw)
    seed = top.take("seed", partial(arguments.whole, most=2**64 - 1)) if "seed" in top else 0
    mesh = MeshRecipe.alone(top)
    assert mesh is not None  # it is needed
    material = MaterialRecipe.alone(top) or MaterialRecipe()
    data = DataRecipe.alone(top) or DataRecipe()
    pairs = PairsRecipe.alone(top) or PairsRecipe()
    top.know(("seed", "train"))
    top.finish()
    low, high = (material.poisson + change for change in pairs.poisson_change)
    if not (low > -1.0 and high < 0.5):
        top.refuse("[pairs] `poisson_change` must keep Poisson's ratio in (-1, 0.5)", pairs.poisson_change)
    return Recipe(Path(path), seed, mesh.file, mesh.n_nodes, mesh.fixed, material, data, pairs, raw)
