"""Supports of a body: nodes that are surely held, nodes that may be held, or only a soft bed around it."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray, IntArray, index_array
from tissuereg._base.choices import HELD, Held
from tissuereg.body.mesh import Mesh, free_triangles
from tissuereg.body.topology import parts_of
from tissuereg.errors import SupportError
from tissuereg.registration.contacts.settings import DISCRETISATION

#: Name of the node set that may or may not be held.
PERHAPS = "perhaps_fixed"


@dataclass(frozen=True, eq=False)
class Supports:
    """Numbers of the nodes that are held, for sure or perhaps.

    `sure` int64 (n,): surely held; `perhaps` int64 (m,): doubtful: they rest on springs of unknown stiffness, under
    unknown tractions.
    """

    sure: IntArray
    perhaps: IntArray

    @property
    def holds(self) -> bool:
        """Whether any node is held, surely or perhaps."""
        return bool(len(self.sure) + len(self.perhaps))

    @property
    def moves(self) -> bool:
        """Whether no node is held at all: a rigid motion is then unknown."""
        return not self.holds

    def digest(self) -> str:
        """Return a SHA-256 fingerprint of both sets of nodes, in hexadecimal digits."""
        parts = (self.sure.astype("<i8").tobytes(), b"|", self.perhaps.astype("<i8").tobytes())
        return hashlib.sha256(b"".join(parts)).hexdigest()

    @classmethod
    def of(cls, mesh: Mesh, held: Held, held_nodes: Any = None) -> "Supports":
        """Return the supports of a mesh; no node is both surely and perhaps held.

        `mesh`: its node sets ``fixed`` and ``perhaps_fixed`` are used; a mesh without either is free; `held` {"sure",
        "perhaps", "free"}: whether the nodes ``fixed`` are surely held, perhaps held or not held; `held_nodes`: node
        numbers instead of the set ``fixed``. Raises `SupportError` if `held` is none of these, a node does not exist,
        or a part of several is not held; `MeshError` if no part of the surface is left that can move.
        """
        check_choice("held", held, HELD, SupportError)
        none = np.empty(0, np.int64)
        fixed = mesh.node_sets.get("fixed", none) if held_nodes is None else _held(mesh, held_nodes)
        perhaps = mesh.node_sets.get(PERHAPS, none)
        if held == "perhaps":
            found = cls(none, np.union1d(fixed, perhaps))
        else:
            sure = fixed if held == "sure" else none
            found = cls(np.asarray(sure, np.int64), np.setdiff1d(perhaps, sure))
        held_nodes = np.union1d(found.sure, found.perhaps)
        free_triangles(mesh, held_nodes)  # refuses a body that cannot move
        _refuse_loose_parts(mesh, held_nodes)
        return found


def _refuse_loose_parts(mesh: Mesh, held: IntArray) -> None:
    """Raise `SupportError` if the body has several parts, and one of them no held node: how it moves is unknown."""
    part = parts_of(mesh)
    size = np.bincount(part)
    loose = np.setdiff1d(np.arange(len(size)), part[held])
    if len(size) > 1 and len(loose):
        message = (
            f"each part of a body must have held nodes, unless it is one part; it has {len(size)} parts that share no "
            f"node, and nothing holds that of {size[loose[0]]} nodes (node {np.argmax(part == loose[0])} is one). If "
            "the parts touch, join their nodes; otherwise register each alone"
        )
        raise SupportError(message, where="mesh")


def _held(mesh: Mesh, nodes: Any) -> IntArray:
    """Return the node numbers that a user gives, int64 (n,), sorted; raise `SupportError` if one is not in the mesh."""
    held = np.unique(index_array("held_nodes", nodes, (None,)))
    if held.size and (held[0] < 0 or held[-1] >= mesh.n_nodes):
        bad = held[0] if held[0] < 0 else held[-1]
        message = f"`held_nodes` must name nodes 0 to {mesh.n_nodes - 1}, got {bad}"
        raise SupportError(message, where="held_nodes")
    return held


def support_warnings(mesh: Mesh, supports: Supports, held: Held) -> list[str]:
    """Return sentences on a body that nothing holds, or that is not held at a set whose name is almost ``fixed``.

    `mesh`: undeformed body; `supports`: its supports; `held` {"sure", "perhaps", "free"}: as stated.
    """
    if held == "free":
        return []
    all_held = np.union1d(supports.sure, supports.perhaps)
    alike = [
        name
        for name, nodes in mesh.node_sets.items()
        if name.strip().lower() in ("fixed", PERHAPS) and not np.isin(nodes, all_held).all()
    ]
    found = [
        f"the nodes of the set {name!r} are not held: the set that is held is named {name.strip().lower()!r}"
        for name in alike
    ]
    if supports.moves:
        known = ", ".join(sorted(mesh.node_sets)) or "none"
        found.append(
            "the body is taken to move freely, since no node is held: the mesh should have a node set named 'fixed' "
            f"(it has: {known}); where nothing holds the body, say so by held='free'"
        )
    return found


def springs_of(mesh: Mesh, supports: Supports) -> list[tuple[IntArray, FloatArray]]:
    """Return the springs under doubtful supports, or the soft bed of a free body.

    `mesh`: undeformed body; `supports`: its supports. Result: for each set of springs its surface triangles, int64 (n,
    3), and the normal and tangential stiffness of one unit per kPa of Young's modulus, (2,), in 1/mm. The sets are the
    rim of the doubtful supports and their inside, or the bed; there is none if all supports are sure.
    """
    if not supports.holds:
        return [(mesh.surface, np.full(2, DISCRETISATION.bed / mesh.extent))]
    triangles = _covering(mesh, supports.perhaps)
    unit = np.full(2, 1.0 / mesh.extent)
    return [(zone, unit) for zone in _zones(mesh, triangles) if len(zone)]


def _zones(mesh: Mesh, triangles: IntArray) -> tuple[IntArray, IntArray]:
    """Return the triangles of the rim of a part of the surface, and of its inside, about half of them each.

    `triangles` int64 (n, 3): the part. Result: two int64 arrays (n_rim, 3) and (n_inside, 3).
    """
    from scipy.spatial import cKDTree

    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    each, count = np.unique(edges, axis=0, return_counts=True)
    border = np.unique(each[count == 1])
    if not len(border):
        return triangles, triangles[:0]
    middles = mesh.nodes[triangles].mean(axis=1)
    depth = np.asarray(cKDTree(mesh.nodes[border]).query(middles)[0])
    inner = depth > np.median(depth)
    return triangles[~inner], triangles[inner]


def _covering(mesh: Mesh, nodes: IntArray) -> IntArray:
    """Return the surface triangles, int64 (m, 3), that cover `nodes`: those within the set, and at its other nodes."""
    count = np.isin(mesh.surface, nodes).sum(axis=1)
    within = count == 3
    left = np.setdiff1d(nodes, mesh.surface[within])
    return np.asarray(mesh.surface[within | np.isin(mesh.surface, left).any(axis=1)])
