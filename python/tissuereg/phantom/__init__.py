"""The breast phantom: embedded meshes, meshes of any number of nodes, trained models, and a synthetic measurement.

The body has two sizes: ``full``, as many nodes as the paper's, which the shipped models were trained on; and ``small``,
for quick examples. The true deformation behind the measurement is known. It was simulated with another model than the
one that users simulate with: another stiffness, a stiff lesion, ten-node elements, a finer mesh that shares no inner
node, and markers between nodes.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import SIZES, Size
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


#: Folders of the models that are shipped for ``phantom_mesh()``, by the names that ``register(..., model=...)`` takes.
SHIPPED_MODELS = {"phantom": "model", "phantom-graph": "graph"}

_FOLDER = Path(str(files("tissuereg.phantom")))


def phantom_mesh(size: Size = "full") -> Mesh:
    """Return the breast phantom's mesh for simulation and registration; its node set ``fixed`` is the chest wall.

    Parameters
    ----------
    size : str
        ``full``: the mesh of 4,258 nodes on which the shipped models were trained, equal to ``breast_mesh(4223)``.
        ``small``: a mesh of 1,213 nodes.

    Returns
    -------
    Mesh
        Mesh in mm, read from the package, so that its fingerprint is the same on every machine.

    Raises
    ------
    ArgumentError
        If `size` is neither of the two.
    """
    return _mesh(size, "body")


def truth_mesh(size: Size = "full") -> Mesh:
    """Return the finer mesh of the breast phantom, on which the synthetic measurement is simulated.

    Parameters
    ----------
    size : str
        Size of the body whose measurement it serves. ``full``: 5,009 corner nodes, ``small``: 1,844; with ten-node
        elements these meshes have 36,521 and 12,542 nodes.

    Returns
    -------
    Mesh
        Mesh in mm. Another program filled the same skin with it (``tools/phantom_meshes.py``).

    Raises
    ------
    ArgumentError
        If `size` is neither of the two.
    """
    return _mesh(size, "truth")


def true_fields(size: Size = "full") -> tuple[FloatArray, FloatArray]:
    """Return the true displacement of the phantom's synthetic deformation, which `event.solve_truth` computed once.

    Parameters
    ----------
    size : str
        Size of the body: ``full`` or ``small``.

    Returns
    -------
    on_truth_mesh, on_body : ndarray of float64, shape (n_nodes, 3)
        Displacement at the nodes of ``truth_mesh(size)`` and at those of ``phantom_mesh(size)``, in mm, rounded to
        single precision.

    Raises
    ------
    ArgumentError
        If `size` is neither of the two.
    """
    with _kept(size, "truth") as kept:
        on_truth_mesh, on_body = (kept[name].astype(np.float64) for name in ("displacement_mm", "on_body_mm"))
    return on_truth_mesh, on_body


def shipped_model_folder(name: str = "phantom") -> Path:
    """Return the folder of a model trained for ``phantom_mesh()``; `name` is a key of `SHIPPED_MODELS`."""
    check_choice("name", name, tuple(SHIPPED_MODELS), ArgumentError)
    return _FOLDER / SHIPPED_MODELS[name]


def _mesh(size: Size, name: str) -> Mesh:
    with _kept(size, name) as kept:
        return Mesh(kept["nodes_mm"], kept["tets"], {"fixed": kept["fixed_nodes"]})


def _kept(size: Size, name: str) -> Any:
    check_choice("size", size, SIZES, ArgumentError)
    return np.load(_FOLDER / "data" / f"{size}-{name}.npz", allow_pickle=False)
