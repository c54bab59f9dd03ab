"""Displacement fields that invert tetrahedra, smoothed near these.

A decoder does not obey mechanics: far from its training data, a few of its tetrahedra may be inverted. Their nodes
repeatedly take the mean displacement of their neighbours, until none is inverted: the field becomes smooth there, and
nowhere else.
"""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh, det_f

#: Tetrahedra below this volume ratio are mended, so that none is left at the edge.
_LEAST = 0.02

#: Rounds at most, and those after which the mended part grows by one ring of nodes.
_ROUNDS, _GROWTH = 60, 10


def repaired(mesh: Mesh, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a displacement field without inverted tetrahedra, if smoothing near them is enough, and its volume ratios.

    `mesh` is the undeformed body, whose fixed nodes keep their displacement; `field` (n_nodes, 3) is a displacement, in
    mm. The first result (n_nodes, 3), in mm, is the given field where no tetrahedron is inverted, and otherwise the one
    with the largest least volume ratio that was found. The second (n_tets,) holds its volume ratios. Cost: volume
    ratios once, and once a round where something is inverted.
    """
    ratios = det_f(mesh, field)
    if float(ratios.min()) > 0.0:
        return field, ratios
    found = best = field
    best_ratios = ratios
    movable = np.ones(mesh.n_nodes, dtype=bool)
    movable[mesh.fixed_nodes] = False
    chosen = np.zeros(mesh.n_nodes, dtype=bool)
    for number in range(_ROUNDS):
        chosen[mesh.tets[ratios < _LEAST]] = True
        if number % _GROWTH == _GROWTH - 1:
            chosen[mesh.tets[chosen[mesh.tets].any(axis=1)]] = True
        around = mesh.tets[chosen[mesh.tets].any(axis=1)]
        total, count = np.zeros_like(field), np.zeros(mesh.n_nodes)
        # Every corner of a tetrahedron gives its displacement to the three others.
        sums = found[around].sum(axis=1)
        for corner in around.T:
            np.add.at(total, corner, sums - found[corner])
            np.add.at(count, corner, 3.0)
        moved = np.flatnonzero(chosen & movable)
        found = found.copy()
        found[moved] = total[moved] / count[moved, None]
        ratios = det_f(mesh, found)
        if ratios.min() > best_ratios.min():
            best, best_ratios = found, ratios
        if ratios.min() > 0.0:
            break
    return best, best_ratios
