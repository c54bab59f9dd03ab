"""Edges of triangles, and the shells (connected parts) of a surface."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.triangles import Triangles, signed_volumes
from tissuereg.errors import MeshError


@dataclass(frozen=True)
class Edges:
    """The edges of m triangles, three for each: from its first to its second corner, to its third, and back.

    `ends` int64 (3 m, 2): vertex indices of start and end, in the triangle's sense; `owner` int64 (3 m,): index of the
    triangle; `group` int64 (3 m,): a number that all edges between the same two vertices share; `count` int64
    (n_groups,): number of edges in each group.
    """

    ends: IntArray  # from, to, in the orientation of the triangle, (3 m, 2)
    owner: IntArray  # the triangle, (3 m,)
    group: IntArray  # the same number for all edges between the same two vertices, (3 m,)
    count: IntArray  # edges in each group: 1 at the rim of a hole, 2 inside, more where walls meet

    @classmethod
    def of(cls, triangles: IntArray) -> "Edges":
        """Return the edges of triangles (m, 3), given as vertex indices; cost: one sort."""
        ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        _, group, count = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
        return cls(ends, np.repeat(np.arange(len(triangles)), 3), group.reshape(-1), count)

    def pairs(self) -> tuple[IntArray, BoolArray]:
        """Return pairs of triangles (k, 2) at edges of two, and whether (k,) both traverse theirs in one direction."""
        order = np.argsort(self.group, kind="stable")
        rows = order[self.count[self.group[order]] == 2].reshape(-1, 2)
        return self.owner[rows], np.asarray(self.ends[rows[:, 0], 0] == self.ends[rows[:, 1], 0])


def agreed_winding(surface: Triangles) -> tuple[IntArray, IntArray]:
    """Return which triangles to turn so that all neighbours agree in winding, (n_turned,), and shells (n_triangles,).

    The first array holds triangle indices, the second the number of each triangle's shell (connected part), from 0, the
    largest area first. Method: every triangle is two vertices of a graph, as given and turned; neighbours are joined
    where they agree. An orientable shell consists of two halves of the graph, of which the one that turns less area is
    chosen. Raises MeshError if a shell is not orientable, like a Moebius strip.
    """
    n, areas = len(surface.triangles), surface.areas
    neighbours, same = Edges.of(surface.triangles).pairs()
    first, second = neighbours[:, 0], neighbours[:, 1]
    across = np.where(same, n, 0)
    to_second = np.concatenate([second + across, second + n - across])
    half = components(np.concatenate([first, first + n]), to_second, 2 * n)
    as_given, turned = half[:n], half[n:]
    if (as_given == turned).any():
        worst = int(np.argmax(as_given == turned))
        place = np.round(surface.corners[worst].mean(axis=0), 3).tolist()
        message = f"a surface must have an inside and an outside; that through {place} mm has one side only"
        raise MeshError(message, where=f"triangle {worst}")
    # Unturned area in either half of the graph; the lower number breaks a tie.
    kept = np.bincount(as_given, areas, minlength=half.max() + 1)
    better = (kept[as_given] > kept[turned]) | ((kept[as_given] == kept[turned]) & (as_given < turned))
    return np.flatnonzero(~better).astype(np.int64), _largest_first(components(first, second, n), areas)


def _largest_first(label: IntArray, areas: FloatArray) -> IntArray:
    """Return labels (n,) of triangles renumbered from 0 by decreasing total area; `areas` (n,): of each, in mm^2."""
    size = np.bincount(label, areas)
    rank = np.empty(len(size), np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    return np.asarray(rank[label], np.int64)


def turned_round(triangles: IntArray, which: IntArray | BoolArray) -> IntArray:
    """Return triangles (m, 3) with the winding of those in `which`, indices or a mask (m,), reversed."""
    changed: IntArray = triangles.copy()
    changed[which] = changed[which][:, [0, 2, 1]]
    return changed


def shell_volumes(surface: Triangles, shell: IntArray) -> FloatArray:
    """Return the volume that each closed shell encloses, (n_shells,), in mm^3; positive if its normals point outwards.

    `shell` (n_triangles,): number of the shell (connected part) of each triangle.
    """
    corners = surface.corners
    share = np.bincount(shell)
    middle = np.stack([np.bincount(shell, corners[:, :, x].mean(axis=1)) / share for x in range(3)], axis=1)
    return np.asarray(np.bincount(shell, signed_volumes(corners - middle[shell][:, None])))


def components(first: IntArray, second: IntArray, n: int) -> IntArray:
    """Return the number of the connected part of each of `n` graph vertices, (n,); edges join `first` and `second`."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
