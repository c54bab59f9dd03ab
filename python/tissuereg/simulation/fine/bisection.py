"""Bisection of tetrahedra at edges: an edge is cut in every tetrahedron that has it, so the mesh stays conforming."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import MeshError
from tissuereg.simulation.settings import FINE

#: Corners of a tet's edges, and the two others.
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

#: Ends of a list of edges.
_PAIR = np.array([[0, 1]])

#: Corners of a triangle's edges.
_SIDES = np.array([[0, 1], [1, 2], [2, 0]])


class Bisection:
    """A tetrahedral mesh whose edges can be cut in two by new nodes.

    `mesh`: the initial mesh; it is not changed. Attributes: `nodes` (n_nodes, 3): those of the mesh, then new ones, mm;
    `tets` int64 (n_tets, 4): node numbers with positive orientation, as in the mesh; `surface` int64 (n_triangles, 3):
    boundary triangles; `parents` int64 (n_nodes, 2): ends of the edge cut by each new node; a node of the initial mesh
    has itself twice; `on_surface` bool (n_nodes,): whether a node lies on the boundary.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.nodes: FloatArray = mesh.nodes.copy()
        self.tets: IntArray = mesh.tets.copy()
        self.surface: IntArray = mesh.surface.copy()
        self.parents: IntArray = np.repeat(np.arange(mesh.n_nodes)[:, None], 2, axis=1)
        self.on_surface = np.zeros(mesh.n_nodes, dtype=bool)
        self.on_surface[mesh.surface_nodes] = True
        self._keys = _keys(self.tets, _EDGES)
        self._surface_keys = _keys(self.surface, _SIDES)

    def surface_edges(self) -> IntArray:
        """Return the edges of the boundary triangles, each once, lower index first, shape (n, 2)."""
        return np.unique(np.sort(self.surface[:, _SIDES].reshape(-1, 2), axis=1), axis=0)

    def cut(self, edges: IntArray, places: FloatArray) -> IntArray:
        """Cut edges in two, in every tetrahedron and boundary triangle that has them; return the new nodes' numbers.

        `edges` int64 (n, 2): ends, each edge once; `places` (n, 3): positions of the new nodes, on or near their edges,
        mm. Result: int64 (n,), in the order of the edges.

        Notes
        -----
        Edges of one tetrahedron are cut in the given order; cutting one edge leaves the others intact.
        """
        keys = _keys(edges, _PAIR)[:, 0]
        rank = np.argsort(keys)
        waiting = keys[rank]
        found = np.empty(len(edges), dtype=np.int64)
        while len(waiting):
            now = self._independent(waiting, rank)
            rows = rank[now]
            found[rows] = self._cut_apart(edges[rows], places[rows])
            waiting, rank = waiting[~now], rank[~now]
        return found

    def refine(self, size: Callable[[FloatArray], FloatArray]) -> None:
        """Cut longest edges until no tetrahedron has an edge longer than allowed (Rivara 1984).

        `size`: function from centres of tetrahedra (n, 3) in mm to the largest edge length allowed for each, (n,) in
        mm. Raises `MeshError` if that takes more than a thousand rounds.

        Notes
        -----
        An edge is cut only if it is the longest in all tetrahedra that have it; if one of these has a longer edge, that
        edge is cut first. This gives a graded mesh.
        """
        allowed = size(self.nodes[self.tets].mean(axis=1))
        length, longest = self._longest(self.tets)
        for _ in range(FINE.most_rounds):
            if not (length > allowed).any():
                return
            marked = np.unique(longest[length > allowed])
            while True:
                tet, side, _ = _found(self._keys, marked)
                more = np.union1d(marked, longest[tet])
                if len(more) == len(marked):
                    break
                marked = more
            edge = self._keys[tet, side]
            blocked = edge[edge != longest[tet]]
            ready = np.setdiff1d(marked, blocked)
            edges = np.stack(np.divmod(ready, _FACTOR), axis=1)
            split = tet[np.isin(edge, ready)]
            before = len(self.tets)
            self._cut_apart(edges, self.nodes[edges].mean(axis=1))
            fresh = np.concatenate([split, np.arange(before, len(self.tets))])
            more_room = np.empty(len(self.tets) - before)
            allowed, length = np.concatenate([allowed, more_room]), np.concatenate([length, more_room])
            longest = np.concatenate([longest, np.empty(len(more_room), np.int64)])
            allowed[fresh] = size(self.nodes[self.tets[fresh]].mean(axis=1))
            length[fresh], longest[fresh] = self._longest(self.tets[fresh])
        message = f"refinement must end within {FINE.most_rounds} rounds; the requested sizes are too small"
        raise MeshError(message, where="refine")

    def mesh(self, node_sets: Mapping[str, IntArray]) -> Mesh:
        """Return the mesh with all cuts made so far, and its node sets.

        `node_sets`: node numbers by name, sets of the initial mesh. A new node belongs to a set if both ends of its
        edge do, and to a set of surface nodes only if it lies on the surface.
        """
        return Mesh(self.nodes, self.tets, {name: self.carried(nodes) for name, nodes in node_sets.items()})

    def carried(self, nodes: IntArray) -> IntArray:
        """Return a node set of the initial mesh with the new nodes that belong to it: node numbers (n,), sorted.

        A new node belongs to it if both ends of its edge do, and, for a set of surface nodes, if it lies on the
        surface.
        """
        member = np.zeros(len(self.nodes), dtype=bool)
        member[nodes] = True
        of_surface = bool(self.on_surface[nodes].all())
        for node in np.flatnonzero(self.parents[:, 0] != self.parents[:, 1]):
            # A node's parents have smaller indices.
            member[node] = member[self.parents[node]].all() and (self.on_surface[node] or not of_surface)
        return np.flatnonzero(member)

    def _longest(self, tets: IntArray) -> tuple[FloatArray, IntArray]:
        """Return the length (n,), mm, and the key (n,) of the longest edge of each of the given tets (n, 4).

        A key is one integer for both ends of an edge. Of equally long edges the one with the largest key is taken.
        """
        ends = np.sort(tets[:, _EDGES], axis=2)
        lengths = np.linalg.norm(self.nodes[ends[..., 1]] - self.nodes[ends[..., 0]], axis=2)
        length = lengths.max(axis=1)
        keys = ends[..., 0] * _FACTOR + ends[..., 1]
        return length, np.where(lengths == length[:, None], keys, -1).max(axis=1)

    def _independent(self, waiting: IntArray, rank: IntArray) -> "np.ndarray[Any, np.dtype[np.bool_]]":
        """Return a mask (n,) of the edges that can be cut now: those that come first in every tet that contains them.

        `waiting` (n,): keys of the edges still to be cut, sorted; `rank` (n,): their place in the order of cutting.
        """
        tet, _, row = _found(self._keys, waiting)
        first = np.full(len(self.tets), len(self.nodes) + len(self.tets))
        np.minimum.at(first, tet, rank[row])
        now = np.ones(len(waiting), dtype=bool)
        now[row[rank[row] != first[tet]]] = False
        return now

    def _cut_apart(self, edges: IntArray, places: FloatArray) -> IntArray:
        """Cut edges (n, 2), no two of one tetrahedron, at places (n, 3), mm; return the new nodes' numbers (n,)."""
        keys = _keys(edges, _PAIR)[:, 0]
        order = np.argsort(keys)
        new = len(self.nodes) + np.arange(len(edges))
        self.tets, self._keys, _ = _halved(self.tets, self._keys, _EDGES, keys[order], new)
        self.surface, self._surface_keys, cut = _halved(self.surface, self._surface_keys, _SIDES, keys[order], new)
        outside = np.zeros(len(edges), dtype=bool)
        outside[cut] = True
        self.nodes = np.concatenate([self.nodes, places[order]])
        self.parents = np.concatenate([self.parents, np.sort(edges, axis=1)[order]])
        self.on_surface = np.concatenate([self.on_surface, outside])
        found = np.empty_like(new)
        found[order] = new
        return found


#: Two node numbers are combined into one key; an upper limit on the number of nodes.
_FACTOR = 2**31


def _keys(cells: IntArray, sides: IntArray) -> IntArray:
    """Return one integer per edge of every cell, (n_cells, n_sides), the same for both directions of an edge.

    `cells` (n_cells, k): node numbers; `sides` (n_sides, 2): corners of a cell that each of its edges joins.
    """
    a, b = cells[:, sides[:, 0]], cells[:, sides[:, 1]]
    return np.asarray(np.minimum(a, b) * _FACTOR + np.maximum(a, b))


def _found(keys: IntArray, few: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return where values of a table `keys` (n, m) occur in a sorted list `few`: rows, columns, and indices in `few`.

    All three results have the shape (n_found,).
    """
    place = np.minimum(np.searchsorted(few, keys.ravel()), len(few) - 1)
    flat = np.flatnonzero(few[place] == keys.ravel())
    rows, columns = np.divmod(flat, keys.shape[1])
    return rows, columns, place[flat]


def _halved(
    cells: IntArray, of_cells: IntArray, sides: IntArray, keys: IntArray, new: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Return cells, and their edges' keys, after each cell that has an edge in `keys` was cut in two there.

    `cells` (n, k): nodes of tets or triangles; `of_cells` (n, n_sides): integer keys of their edges; `sides` (n_sides,
    2): corners that each edge joins; `keys` (m,): edges to cut, sorted, at most one per cell; `new` (m,): the nodes at
    which they are cut. The third result holds the indices in `keys` of the edges that some cell has, sorted.
    """
    cell, side, row = _found(of_cells, keys)
    first, second = cells[cell], cells[cell]
    each = np.arange(len(cell))
    first[each, sides[side, 0]] = new[row]
    second[each, sides[side, 1]] = new[row]
    kept, kept_keys = cells.copy(), of_cells.copy()
    kept[cell], kept_keys[cell] = first, _keys(first, sides)
    return np.concatenate([kept, second]), np.concatenate([kept_keys, _keys(second, sides)]), np.unique(row)


def shape_quality(nodes: FloatArray, tets: IntArray) -> FloatArray:
    """Return the mean ratio of tetrahedra, a shape quality: 1 where regular, 0 where flat, negative where inverted.

    `nodes` (n_nodes, 3): mm; `tets` int64 (n_tets, 4): nodes of each. Result: (n_tets,), ``12 (3 V)^(2/3) / sum of
    squared edges`` with the volume V, and with the sign of V.
    """
    corners = nodes[tets]
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    volume = np.einsum("ij,ij->i", np.cross(a, b), c) / 6.0
    squares = ((corners[:, _EDGES[:, 0]] - corners[:, _EDGES[:, 1]]) ** 2).sum(axis=(1, 2))
    return np.asarray(np.sign(volume) * 12.0 * np.cbrt(3.0 * np.abs(volume)) ** 2 / squares)
