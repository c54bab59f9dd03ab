"""Whether decoded fields are possible shapes: det F of every tetrahedron."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from tissuereg_training.data import FieldArray
from tissuereg_training.evaluate import decoded
from tissuereg_training.graph import IntArray
from tissuereg_training.network import Network

Float64Array = npt.NDArray[np.float64]

#: Draws of N(0, I) that a model card judges, and how many are decoded at a time.
N_SAMPLES = 1000
_PART = 50


def volume_ratios(nodes: Float64Array, tets: IntArray, fields: FieldArray) -> Float64Array:
    """Return det F, deformed over undeformed volume, of every tetrahedron.

    Parameters
    ----------
    nodes : ndarray of float64, shape (n_nodes, 3)
        At rest, mm.
    tets : ndarray of int64, shape (n_tets, 4)
        Node indices.
    fields : ndarray of float32, shape (n_fields, n_nodes, 3)
        Displacement in mm.

    Returns
    -------
    ndarray of float64, shape (n_fields, n_tets)
        Dimensionless; not positive where a tetrahedron is inverted.
    """
    ratios: Float64Array = _volumes(nodes + fields, tets) / _volumes(nodes[None], tets)
    return ratios


def inversions(nodes: Float64Array, tets: IntArray, parts: Iterable[FieldArray]) -> dict[str, Any]:
    """Return how near fields come to turning tetrahedra inside out.

    Parameters
    ----------
    nodes, tets : ndarray
        As for `volume_ratios`.
    parts : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        Fields in mm; at least one.

    Returns
    -------
    dict
        ``fields`` (how many), ``min_det_f``, ``inverted_tets`` (share of all tetrahedra of all fields) and
        ``fields_with_inverted_tets`` (share of the fields).
    """
    smallest, inverted = [], []
    for part in parts:
        ratios = volume_ratios(nodes, tets, part)
        smallest.append(ratios.min(axis=1))
        inverted.append((ratios <= 0).mean(axis=1))
    lowest, shares = np.concatenate(smallest), np.concatenate(inverted)
    return {
        "fields": len(lowest),
        "min_det_f": round(float(lowest.min()), 4),
        "inverted_tets": float(shares.mean()),
        "fields_with_inverted_tets": float((lowest <= 0).mean()),
    }


def sampled_inversions(model: Network, nodes: Float64Array, tets: IntArray, seed: int) -> dict[str, Any]:
    """Return `inversions` of `N_SAMPLES` decoded draws of the prior N(0, I).

    Parameters
    ----------
    model : Network
        Trained.
    nodes, tets : ndarray
        As for `volume_ratios`.
    seed : int
        Of the draws.

    Returns
    -------
    dict
        As of `inversions`.
    """
    draws = np.random.default_rng([seed, 14]).standard_normal((N_SAMPLES, model.n_latent), dtype=np.float32)
    return inversions(nodes, tets, (decoded(model, z) for z in torch.split(torch.from_numpy(draws), _PART)))


def _volumes(places: Float64Array, tets: IntArray) -> Float64Array:
    """Return six times the volumes (n_fields, n_tets) of places (n_fields, n_nodes, 3)."""
    first, *others = (places[:, tets[:, k]] for k in range(4))
    a, b, c = (other - first for other in others)
    volumes: Float64Array = np.einsum("fti,fti->ft", np.cross(a, b), c)
    return volumes
