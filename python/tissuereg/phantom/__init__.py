"""The breast phantom: embedded meshes, others of any number of nodes, a trained model, and a synthetic measurement.

The body has two sizes: ``full``, as many nodes as the paper's, which the shipped model was trained on; and ``small``,
for quick examples. The measurement's truth is known. It comes from another model than the one that users simulate
with: another stiffness, a stiff lesion, ten-node elements, a finer mesh that shares no inner node, markers between
nodes.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError
from tissuereg.phantom.breast import breast_mesh

__all__ = [
    "SIZES",
    "breast_mesh",
    "phantom_mesh",
    "shipped_model_folder",
    "shipped_recipe",
    "true_fields",
    "truth_mesh",
]

#: Sizes of the embedded body.
SIZES = ("full", "small")

_FOLDER = Path(str(files("tissuereg.phantom")))


def phantom_mesh(size: str = "full") -> Mesh:
    """Return the mesh to simulate and register on; its node set ``fixed`` is the chest wall.

    Parameters
    ----------
    size : str
        ``full``: 4,258 nodes, ``breast_mesh(4223)``, which the shipped model was trained on. ``small``: 1,213 nodes.

    Returns
    -------
    Mesh
        Read from the package, so that it has the same digest on every machine.

    Raises
    ------
    ArgumentError
        If there is no such size.
    """
    return _mesh(size, "body")


def truth_mesh(size: str = "full") -> Mesh:
    """Return the finer mesh on which the measurement is made.

    Parameters
    ----------
    size : str
        Of the body that it belongs to. ``full``: 5,009 corner nodes, ``small``: 1,844; with ten-node elements 36,521
        and 12,542 nodes.

    Returns
    -------
    Mesh
        Another program filled the same skin with it (``tools/phantom_meshes.py``).

    Raises
    ------
    ArgumentError
        If there is no such size.
    """
    return _mesh(size, "truth")


def true_fields(size: str = "full") -> tuple[FloatArray, FloatArray]:
    """Return the true displacement of the phantom's event, as `tissuereg.phantom.event.solve_truth` gave it.

    Parameters
    ----------
    size : str
        Of the body.

    Returns
    -------
    on_truth_mesh, on_body : ndarray of float64, shape (n_nodes, 3)
        At the nodes of ``truth_mesh(size)`` and of ``phantom_mesh(size)``, mm, rounded to single precision.

    Raises
    ------
    ArgumentError
        If there is no such size.
    """
    with _kept(size, "truth") as kept:
        on_truth_mesh, on_body = (kept[name].astype(np.float64) for name in ("displacement_mm", "on_body_mm"))
    return on_truth_mesh, on_body


def shipped_model_folder() -> Path:
    """Return the folder of the model trained for ``phantom_mesh()``, which ``register(..., model="phantom")`` takes."""
    return _FOLDER / "model"


def _mesh(size: str, name: str) -> Mesh:
    with _kept(size, name) as kept:
        return Mesh(kept["nodes_mm"], kept["tets"], {"fixed": kept["fixed_nodes"]})


def _kept(size: str, name: str) -> Any:
    check_choice("size", size, SIZES, ArgumentError)
    return np.load(_FOLDER / "data" / f"{size}-{name}.npz", allow_pickle=False)
