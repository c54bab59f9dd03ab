"""Pairs of simulation and truth: a data set's own, and those of a folder of .npz files."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.npz import open_npz

#: Schema of the pairs of a data set.
PAIRS_SCHEMA = "tissuereg.pairs/1"


def check_pairs(file: Any, where: str, mark: str) -> None:
    """Check that an open file holds the pairs of a data set.

    `file`: the open file; `where`: its name, for messages; `mark`: SHA-256 of the data set's recipe. Raises
    `FormatError` if it holds something else.
    """
    if (file.attrs.get("schema"), file.attrs.get("recipe_sha256")) != (PAIRS_SCHEMA, mark):
        message = f"{where} must hold the pairs of this data set ({PAIRS_SCHEMA}); it holds something else"
        raise FormatError(message, where=where)


def read_pairs(folder: str | os.PathLike[str], n_nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return simulations and truths of the same events.

    `folder`: holds ``pairs_*.npz`` with ``simulation_mm`` and ``truth_mm``, each (n, n_nodes, 3); they are joined in
    the order of their names; `n_nodes`: nodes of the mesh. Result: `simulations`, `truths` (n_pairs, n_nodes, 3): in
    mm. Raises `FormatError` if there is no such file, or an array is missing or of another shape.
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
