"""The quantities of a body that depend on its mesh and supports alone: analysed solver, patches, stiffness fields."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg.body.mesh import Mesh
from tissuereg.registration.contacts.patches import Patches, make_patches
from tissuereg.registration.contacts.places import smooth_fields
from tissuereg.registration.contacts.settings import DISCRETISATION, EFFORT
from tissuereg.registration.contacts.supports import Supports, springs_of
from tissuereg.simulation.solve import Simulator

_kept: "OrderedDict[tuple[str, str, str], ContactBody]" = OrderedDict()
_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class HeldEdge:
    """Where the sure supports of a body end.

    `at`, `free` int64 (n_edges,): the held and the free node of every edge of a tet that leaves the supports; `rim`
    int64 (n_rim,): those held nodes at which the free surface begins; `column` int64 (n_held,): place of each held node
    in `rim`, n_rim for those off it; `smooth` (n_fields, n_rim): smooth fields over the rim.
    """

    at: IntArray
    free: IntArray
    rim: IntArray
    column: IntArray
    smooth: FloatArray


@dataclass(frozen=True, eq=False)
class ContactBody:
    """A mesh with all that a search for contacts needs and that depends on mesh and supports alone.

    `mesh`: undeformed body; `supports`: nodes that are surely held, and doubtful ones that are perhaps held;
    `simulator`: finite-element solver whose matrices have been analysed for this mesh; `patches`: overlapping round
    parts of the free surface on which contacts may act; `base`: parts of the doubtful supports on which unknown
    tractions may act; None if no support is doubtful; `springs`: for each set of springs its surface triangles, int64
    (n, 3), and the factors (2,), 1/mm, by which Young's modulus in kPa is multiplied to get a unit of normal and of
    tangential stiffness in kPa/mm.
    """

    mesh: Mesh
    supports: Supports
    simulator: Simulator
    patches: Patches
    base: Patches | None
    springs: list[tuple[IntArray, FloatArray]] = field(repr=False)

    @cached_property
    def profiles(self) -> FloatArray:
        """Coordinates of the tets' centroids along the principal axes, -1 to 1 across the body, (3, n_tets)."""
        mesh = self.mesh
        centred = mesh.nodes - mesh.nodes.mean(axis=0)
        axes = np.linalg.eigh(centred.T @ centred)[1]
        along = mesh.nodes @ axes
        middle, half = 0.5 * (along.max(axis=0) + along.min(axis=0)), 0.5 * np.ptp(along, axis=0)
        return np.asarray(((mesh.nodes[mesh.tets].mean(axis=1) @ axes - middle) / half).T)

    @cached_property
    def node_volumes(self) -> FloatArray:
        """Integral of each node's shape function over the body, shape (n_element_nodes,), in mm^3."""
        body = self.simulator.body
        shares = np.zeros(body.n_nodes)
        if body.element == "tet10":
            # Second-order shape functions: -1/20 of the volume at corners, 1/5 at middles of edges.
            np.add.at(shares, self.mesh.tets, -0.05 * self.mesh.volumes[:, None])
            keys = self.mesh.edges[:, 0] * self.mesh.n_nodes + self.mesh.edges[:, 1]
            for pair in ([0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]):
                ends = np.sort(self.mesh.tets[:, pair], axis=1)
                middle = self.mesh.n_nodes + np.searchsorted(keys, ends[:, 0] * self.mesh.n_nodes + ends[:, 1])
                np.add.at(shares, middle, 0.2 * self.mesh.volumes)
            return shares
        np.add.at(shares, self.mesh.tets, 0.25 * self.mesh.volumes[:, None])
        return shares

    @cached_property
    def held_edge(self) -> "HeldEdge | None":
        """Where the sure supports end; None if no node is surely held, or no free surface meets them."""
        mesh, held = self.mesh, self.supports.sure
        is_held = np.zeros(mesh.n_nodes, dtype=bool)
        is_held[held] = True
        ends = mesh.edges[is_held[mesh.edges].sum(axis=1) == 1]
        inner = is_held[ends[:, 0]]
        at, free = np.where(inner, ends[:, 0], ends[:, 1]), np.where(inner, ends[:, 1], ends[:, 0])
        rim = np.intersect1d(at, mesh.surface[~is_held[mesh.surface].all(axis=1)])
        if not len(rim):
            return None
        column = np.full(mesh.n_nodes, len(rim))
        column[rim] = np.arange(len(rim))
        return HeldEdge(at, free, rim, column[held], smooth_fields(mesh.nodes[rim], DISCRETISATION.support_fields))

    @classmethod
    def of(cls, mesh: Mesh, supports: Supports, element: Element = "tet4") -> "ContactBody":
        """Return the prepared body of a mesh, from the cache or made anew.

        `mesh`: undeformed body; `supports`: nodes that are held, for sure or perhaps; `element` {"tet4",
        "tet4-averaged", "tet10"}: finite elements of the solver. Cost if it is not cached: about half a second on 4,000
        nodes.
        """
        key = (mesh.digest(), supports.digest(), element)
        with _lock:
            found = _kept.get(key)
            if found is not None:
                _kept.move_to_end(key)
                return found
        made = cls._made(mesh, supports, element)
        with _lock:
            _kept[key] = made
            while len(_kept) > EFFORT.bodies_kept:
                _kept.popitem(last=False)
        return made

    @classmethod
    def _made(cls, mesh: Mesh, supports: Supports, element: Element) -> "ContactBody":
        springs = springs_of(mesh, supports)
        rests = len(supports.sure) == 0
        simulator = Simulator(mesh, element=element, held_nodes=supports.sure, springs=springs, rests=rests)
        free = np.setdiff1d(mesh.surface_nodes, np.union1d(supports.sure, supports.perhaps))
        base = None
        if len(supports.perhaps):
            base = make_patches(mesh, np.intersect1d(mesh.surface_nodes, supports.perhaps))
        return cls(
            mesh,
            supports,
            simulator,
            make_patches(mesh, free),
            base,
            springs,
        )


def forget_bodies() -> None:
    """Empty the cache of prepared bodies (`ContactBody.of`)."""
    with _lock:
        _kept.clear()
