"""Statistics of a data set's members: size of their displacements, and distances between members."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.io.chunks import Fields
from tissuereg.simulation.settings import DATA_SET

#: Quantiles that are stated.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacement statistics of k members (simulations) of a data set.

    `mean_mm`, `largest_mm` (k,): mean and largest displacement of a member's nodes, mm; `apart_mm` (n_pairs,): mean
    distance between corresponding nodes of two members, mm, for pairs of members.
    """

    mean_mm: FloatArray
    largest_mm: FloatArray
    apart_mm: FloatArray


def motion_of(displacement: Fields) -> Motion:
    """Return displacement statistics of a chunk's members (simulations).

    `displacement` float32 (k, n_nodes, 3): displacement of each member, mm. Distances are taken between all pairs of
    the first 32 members.
    """
    moved = np.linalg.norm(displacement.astype(np.float64), axis=2)
    few = displacement[: DATA_SET.paired].astype(np.float64)
    apart = [np.linalg.norm(few[i + 1 :] - few[i], axis=2).mean(axis=1) for i in range(len(few) - 1)]
    return Motion(moved.mean(axis=1), moved.max(axis=1), np.concatenate([np.empty(0), *apart]))


def motion_summary(motions: Sequence[Motion]) -> dict[str, object]:
    """Return means and quantiles, in mm, of the displacement statistics of all members of a data set.

    `motions`: one per chunk. Result: ``quantiles`` (the probabilities); for each of ``mean_node_mm``, ``largest_mm``
    and ``apart_mm`` a dict of ``mean``, ``quantiles`` and ``largest``, or None without values; ``n_pairs``;
    ``share_apart_7_mm``, the share of pairs at least 7 mm apart (None without pairs).
    """
    mean, largest, apart = (
        np.concatenate([np.empty(0), *(getattr(motion, name) for motion in motions)])
        for name in ("mean_mm", "largest_mm", "apart_mm")
    )
    return {
        "quantiles": list(QUANTILES),
        "mean_node_mm": _spread(mean),
        "largest_mm": _spread(largest),
        "apart_mm": _spread(apart),
        "n_pairs": len(apart),
        "share_apart_7_mm": float(np.mean(apart >= DATA_SET.far_mm)) if len(apart) else None,
    }


def _spread(values: FloatArray) -> dict[str, object] | None:
    if not len(values):
        return None
    return {
        "mean": float(values.mean()),
        "quantiles": [float(one) for one in np.quantile(values, QUANTILES)],
        "largest": float(values.max()),
    }
