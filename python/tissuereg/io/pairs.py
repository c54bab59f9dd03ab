"""Pairs of simulation and truth from a folder of .npz files."""

import os
from pathlib import Path

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.npz import open_npz


def read_pairs(folder: str | os.PathLike[str], n_nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return simulations and truths of the same events.

    Parameters
    ----------
    folder : path-like
        Holds ``pairs_*.npz`` with ``simulation_mm`` and ``truth_mm``, each (n, n_nodes, 3); they are joined in the
        order of their names.
    n_nodes : int
        Nodes of the mesh.

    Returns
    -------
    simulations, truths : ndarray of float64, shape (n_pairs, n_nodes, 3)
        In mm.

    Raises
    ------
    FormatError
        If there is no such file, or an array is missing or of another shape.
    """
    files = sorted(Path(folder).glob("pairs_*.npz"))
    if not files:
        message = f"{folder} must hold files pairs_*.npz; there are none"
        raise FormatError(message, where=str(folder))
    simulations, truths = [], []
    for path in files:
        with open_npz(path) as file:
            simulations.append(file.floats("simulation_mm", None, n_nodes, 3))
            truths.append(file.floats("truth_mm", len(simulations[-1]), n_nodes, 3))
    return np.concatenate(simulations), np.concatenate(truths)
