"""The mesh of a data set, kept beside its chunks."""

import io

import numpy as np

from tissuereg.body.mesh import Mesh
from tissuereg.io.meshes import mesh_from_archive
from tissuereg.io.npz import npz_of_bytes
from tissuereg.io.stores import Store

MESH_NAME = "mesh.npz"


def pack_mesh(mesh: Mesh) -> bytes:
    """Return the file of a mesh: the same bytes for the same mesh."""
    whole = io.BytesIO()
    np.savez(whole, nodes_mm=mesh.nodes, tets=mesh.tets, fixed_nodes=mesh.fixed_nodes)
    return whole.getvalue()


def read_data_mesh(store: Store) -> Mesh:
    """Return the mesh of a data set from its place.

    Raises
    ------
    FormatError, MeshError, ShapeError
        If it is missing, spoilt or unusable.
    """
    with npz_of_bytes(store.where(MESH_NAME), store.read(MESH_NAME)) as kept:
        return mesh_from_archive(kept)
