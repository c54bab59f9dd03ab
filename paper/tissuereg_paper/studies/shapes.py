"""Shapes that no model was trained on: the test split of a data set, made again from its recipe when they are needed.

A member of a data set depends on the recipe and its own number alone, so a study needs no data set on the disk.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tissuereg import Mesh
from tissuereg._base.arrays import IntArray
from tissuereg.errors import EnsembleError, ModelError
from tissuereg.io.datasets import split_of
from tissuereg.phantom.event import shipped_recipe
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.recipe import Recipe

#: Displacements of several shapes, single precision as data sets keep them.
Fields = npt.NDArray[np.float32]

#: Members of the shipped model's data that have no equilibrium; the others are split.
FAILED = (1468, 2494, 3990, 6405, 9619)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The test split of a data set.

    Parameters
    ----------
    recipe : Recipe
        Recipe of the data set.
    mesh : Mesh
        Its mesh.
    failed : tuple of int
        Numbers of its members that have no equilibrium.
    """

    recipe: Recipe
    mesh: Mesh
    failed: tuple[int, ...] = ()

    @cached_property
    def numbers(self) -> IntArray:
        """Numbers in the recipe of the members of the test split, ascending."""
        index = np.setdiff1d(np.arange(self.recipe.data.members), self.failed)
        return np.asarray(index[split_of(len(index), self.recipe.seed)["test"]], np.int64)

    def fields(self, numbers: IntArray, threads: int = 0) -> Fields:
        """Return the displacements of some members, solved now.

        Parameters
        ----------
        numbers : ndarray of int64, shape (k,)
            Numbers of members in the recipe.
        threads : int
            Threads to use; 0 takes all cores. The result does not depend on it.

        Returns
        -------
        ndarray of float32, shape (k, n_nodes, 3)
            mm; those of the data set, bit for bit where the machine is alike.

        Raises
        ------
        EnsembleError
            If a member finds no equilibrium.
        """
        maker = ChunkMaker(self.recipe, self.mesh, self.recipe.seed)
        fields = np.empty((len(numbers), self.mesh.n_nodes, 3), np.float32)
        chunks = numbers // self.recipe.data.chunk
        for chunk in np.unique(chunks):
            wanted = np.unique(numbers[chunks == chunk])
            made = maker.make(int(chunk), threads, rows=wanted - chunk * self.recipe.data.chunk)
            if made.failed:
                message = (
                    f"every shape of a study must be an equilibrium; member {made.failed[0][0]}: {made.failed[0][1]}"
                )
                raise EnsembleError(message, dropped=made.failed)
            rows = np.flatnonzero(chunks == chunk)
            fields[rows] = made.displacement[np.searchsorted(wanted, numbers[rows])]
        return fields


def held_out_of(mesh_digest: str) -> HeldOut:
    """Return the test split of the data set on a mesh.

    Parameters
    ----------
    mesh_digest : str
        Fingerprint of the mesh, from a model's card.

    Returns
    -------
    HeldOut
        With the mesh.

    Raises
    ------
    ModelError
        If it is not the mesh of the shipped model's data.
    """
    recipe = shipped_recipe()
    mesh = recipe.mesh()
    if mesh.digest() == mesh_digest:
        return HeldOut(recipe, mesh, FAILED)
    message = (
        "the model of a study must be one of the phantom's body, whose recipe travels with the package; "
        f"this one knows another mesh ({mesh_digest[:12]})"
    )
    raise ModelError(message, where="model")
