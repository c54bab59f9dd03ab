"""The breast phantom: two embedded meshes, others of any size, a trained network, and a synthetic measurement.

The measurement's truth is known. It comes from another model than the one that users simulate with: another stiffness,
a stiff lesion, ten-node elements, a finer mesh that shares no inner node, markers between nodes.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np

from tissuereg.mesh import Mesh
from tissuereg.phantom.breast import breast_mesh

__all__ = ["breast_mesh", "phantom_mesh", "shipped_model_folder", "truth_mesh"]

_FOLDER = Path(str(files("tissuereg.phantom")))


def phantom_mesh() -> Mesh:
    """Return the mesh to simulate and register on: 1,213 nodes, node set ``fixed`` is the chest wall."""
    return _mesh("body")


def truth_mesh() -> Mesh:
    """Return the finer mesh on which the measurement is made: 1,844 corner nodes."""
    return _mesh("truth")


def shipped_model_folder() -> Path:
    """Return the folder of the network trained for `phantom_mesh`."""
    return _FOLDER / "model"


def _mesh(name: str) -> Mesh:
    with np.load(_FOLDER / "data" / f"{name}.npz", allow_pickle=False) as kept:
        return Mesh(kept["nodes_mm"], kept["tets"], {"fixed": kept["fixed_nodes"]})
