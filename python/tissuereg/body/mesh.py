"""A tetrahedral mesh in its reference shape: nodes, tetrahedra (tets) and named sets of nodes."""

import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property, wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import check_choice, named, real, text
from tissuereg._base.arrays import FloatArray, IntArray, float_array, frozen, index_array
from tissuereg._base.choices import FRAMES, Frame
from tissuereg._base.provenance import derived
from tissuereg._base.shown import notebook
from tissuereg._core import check_mesh, surface_triangles, tet_volumes
from tissuereg.errors import MeshError, UnitError

#: Extents, in mm, outside which a body is taken to be in other units.
PLAUSIBLE_EXTENT_MM = (1.0, 3000.0)


class Mesh:
    """A mesh of four-node tetrahedra (tets) in the undeformed shape of a body.

    Parameters
    ----------
    nodes : array_like of float, shape (n_nodes, 3)
        Coordinates of the nodes in mm.
    tets : array_like of int, shape (n_tets, 4)
        Node indices (a, b, c, d) of every tet, ordered for positive volume: d lies on the side to which (b-a) x (c-a)
        points.
    node_sets : mapping of str to array_like of int, optional
        Node indices by the name of a set. The nodes of the set ``fixed`` are held: they have a prescribed displacement.
    frame : {"LPS", "RAS"}, optional
        Declared patient frame of the coordinates. Nothing is computed from it; files of a format that states a frame
        are written in it.

    Raises
    ------
    ShapeError
        If an array has another shape or dtype.
    MeshError
        If a coordinate is not finite, an index is out of range, a tet is inverted or degenerate, a node belongs to no
        tet, or `frame` is neither of the two.
    UnitError
        If the largest extent of the body is outside 1 to 3000 mm, so that the coordinates are probably not in mm.

    Examples
    --------
    >>> mesh = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> mesh
    Mesh(4 nodes, 1 tets, node sets: fixed (3))
    """

    def __init__(
        self, nodes: Any, tets: Any, node_sets: Mapping[str, Any] | None = None, frame: Frame | None = None
    ) -> None:
        if frame is not None:
            check_choice("frame", frame, FRAMES, MeshError)
        points = float_array("nodes", nodes, (None, 3))
        cells = index_array("tets", tets, (None, 4))
        check_mesh(points, cells)
        _check_extent(points)
        self.nodes: FloatArray = frozen(points.copy() if points is nodes else points)
        self.tets: IntArray = frozen(cells.copy() if cells is tets else cells)
        self.node_sets: dict[str, IntArray] = {
            name: _node_set(name, indices, len(points))
            for name, indices in named("node_sets", node_sets, error=MeshError).items()
        }
        self.frame = frame

    def __repr__(self) -> str:
        sets = ", ".join(f"{name} ({len(indices)})" for name, indices in self.node_sets.items()) or "none"
        return f"Mesh({self.n_nodes} nodes, {self.n_tets} tets, node sets: {sets})"

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("body", self)

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_tets(self) -> int:
        """Number of tetrahedra."""
        return len(self.tets)

    @property
    def fixed_nodes(self) -> IntArray:
        """Sorted indices of the held nodes, those of the node set ``fixed``, shape (n,).

        Raises
        ------
        MeshError
            If the mesh has no such set, or an empty one.
        """
        return self.node_set("fixed")

    def node_set(self, name: str) -> IntArray:
        """Return the indices of a named node set.

        Parameters
        ----------
        name : str
            Name of the set.

        Returns
        -------
        ndarray of int64, shape (n,)
            Sorted indices without repeats.

        Raises
        ------
        MeshError
            If there is no such set, or if it is empty.
        """
        if text("name", name, error=MeshError) not in self.node_sets:
            known = ", ".join(sorted(self.node_sets)) or "none"
            message = f"the mesh must have a node set named '{name}'; it has: {known}"
            raise MeshError(message, where=name)
        if len(self.node_sets[name]) == 0:
            message = f"node set '{name}' must hold at least one node; it is empty"
            raise MeshError(message, where=name)
        return self.node_sets[name]

    def with_node_set(self, name: str, indices: Any) -> "Mesh":
        """Return the same mesh with one node set added or replaced.

        Parameters
        ----------
        name : str
            Name of the set.
        indices : array_like of int, shape (n,)
            Indices of its nodes.

        Returns
        -------
        Mesh
            A new mesh, with the same nodes and tets.
        """
        text("name", name, error=MeshError)
        return derived(Mesh(self.nodes, self.tets, {**self.node_sets, name: indices}, self.frame), self)

    def in_frame(self, frame: Frame | None) -> "Mesh":
        """Return the same mesh with its coordinates declared to be in a frame; no coordinate is changed.

        Parameters
        ----------
        frame : {"LPS", "RAS"} or None
            Patient frame of the coordinates; None states that it is unknown.

        Returns
        -------
        Mesh
            A new mesh, with the same nodes and tets.
        """
        return derived(Mesh(self.nodes, self.tets, self.node_sets, frame), self)

    @cached_property
    def extent(self) -> float:
        """Largest extent of the nodes along a coordinate axis, in mm."""
        return float(np.max(np.ptp(self.nodes, axis=0)))

    @cached_property
    def surface(self) -> IntArray:
        """Boundary triangles as node indices, ordered so that normals point outwards, shape (n_triangles, 3)."""
        return frozen(surface_triangles(self.nodes, self.tets))

    @cached_property
    def surface_nodes(self) -> IntArray:
        """Sorted indices of the nodes on the boundary, shape (n,)."""
        return frozen(np.unique(self.surface))

    def surface_nodes_within(self, centre: Any, radius: float) -> IntArray:
        """Return the indices of the surface nodes that lie within a ball.

        Parameters
        ----------
        centre : array_like of float, shape (3,)
            Centre of the ball in mm.
        radius : float
            Radius of the ball in mm.

        Returns
        -------
        ndarray of int64, shape (n,)
            Sorted; may be empty.
        """
        distance = np.linalg.norm(self.nodes[self.surface_nodes] - float_array("centre", centre, (3,)), axis=1)
        return np.asarray(self.surface_nodes[distance <= real("radius", radius, error=MeshError)])

    @cached_property
    def edges(self) -> IntArray:
        """Node indices of the edges of all tets, shape (n_edges, 2); each edge stands once, its lower index first."""
        pairs = self.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
        return frozen(np.unique(np.sort(pairs, axis=1), axis=0))

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of every tet in mm^3, shape (n_tets,)."""
        return frozen(tet_volumes(self.nodes, self.tets))

    def digest(self) -> str:
        """Return a fingerprint (hash) of the coordinates, the tets and the node set ``fixed``.

        Returns
        -------
        str
            SHA-256 in hexadecimal digits. Coordinates are rounded to 1e-6 mm first, so that a mesh read back from a
            text file has the same fingerprint.
        """
        digest = hashlib.sha256()
        digest.update(np.round(self.nodes * 1e6).astype("<i8").tobytes())
        digest.update(self.tets.astype("<i8").tobytes())
        digest.update(self.node_sets.get("fixed", np.empty(0, np.int64)).astype("<i8").tobytes())
        return digest.hexdigest()


def node_normals(mesh: Mesh, areas: FloatArray) -> FloatArray:
    """Return unit normals at the nodes: means of the normals of the adjacent surface triangles, weighted by area.

    `areas` (n_triangles, 3): for every triangle of `Mesh.surface` its outward normal vector, whose length is
    proportional to the triangle's area. Result: (n_nodes, 3), zero at inner nodes.
    """
    total = np.zeros_like(mesh.nodes)
    for corner in range(3):
        np.add.at(total, mesh.surface[:, corner], areas)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny))


def free_triangles(mesh: Mesh, held: IntArray) -> npt.NDArray[np.bool_]:
    """Return which surface triangles (n_triangles,) are free: those of which not all three corners are `held` nodes.

    Raises `MeshError` if none is: such a body cannot move.
    """
    free: npt.NDArray[np.bool_] = np.logical_not(np.isin(mesh.surface, held).all(axis=1))
    if not free.any():
        message = (
            f"a body must have a part of its surface that can move; every boundary triangle is held, all {len(free)}"
        )
        raise MeshError(message, where="fixed")
    return free


def free_surface(mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """Return the surface triangles (k, 3) not held at all three corners, and each one's share (k,) in their area."""
    free = mesh.surface[free_triangles(mesh, mesh.fixed_nodes)]
    corners = mesh.nodes[free]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return free, areas / areas.sum()


def random_simplices(mesh: Mesh, n_triangles: int, n_tets: int, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Return corners of random free surface triangles (n_triangles, 3), by area, and tets (n_tets, 4), by volume."""
    free, shares = free_surface(mesh)
    triangles = free[rng.choice(len(free), n_triangles, p=shares)]
    return triangles, mesh.tets[rng.choice(mesh.n_tets, n_tets, p=mesh.volumes / mesh.volumes.sum())]


def det_f(mesh: Mesh, displacement: FloatArray) -> FloatArray:
    """Return the volume ratio of every tet under a displacement of the nodes.

    `mesh`: mesh in the reference shape; `displacement` (..., n_nodes, 3): displacements in mm; leading axes are kept.
    Result: (..., n_tets), determinant of the deformation gradient F, dimensionless; not positive where a tet is
    inverted.
    """
    places = np.ascontiguousarray(mesh.nodes + displacement)
    volumes = [tet_volumes(one, mesh.tets) for one in places.reshape(-1, mesh.n_nodes, 3)]
    return np.asarray(np.array(volumes).reshape(*places.shape[:-2], mesh.n_tets) / mesh.volumes)


def _node_set(name: str, indices: Any, n_nodes: int) -> IntArray:
    array = np.unique(index_array(f"node_sets[{name!r}]", indices, (None,)))
    if array.size and (array[0] < 0 or array[-1] >= n_nodes):
        bad = array[0] if array[0] < 0 else array[-1]
        message = f"node set '{name}' must name nodes 0 to {n_nodes - 1}, got {bad}"
        raise MeshError(message, where=name)
    return frozen(array)


def _check_extent(nodes: FloatArray) -> None:
    extent = float(np.max(np.ptp(nodes, axis=0)))
    lowest, highest = PLAUSIBLE_EXTENT_MM
    if not lowest <= extent <= highest:
        message = (
            f"lengths must be in mm: a body of extent {extent:.4g} mm is outside {lowest:g} to {highest:g} mm; "
            "convert (metres: times 1000, centimetres: times 10, micrometres: times 0.001)"
        )
        raise UnitError(message, where="nodes")


Made = TypeVar("Made")


def per_mesh(make: Callable[[Mesh], Made]) -> Callable[[Mesh], Made]:
    """Return a function that calls `make` once for each mesh and afterwards returns the kept result for that mesh.

    A result is dropped with its mesh, whose arrays never change. Two threads that ask for the same mesh at the same
    time may both compute the result; both get the same value.
    """
    kept: WeakKeyDictionary[Mesh, Made] = WeakKeyDictionary()

    @wraps(make)
    def found(mesh: Mesh) -> Made:
        answer = kept.get(mesh)
        if answer is None:
            answer = kept[mesh] = make(mesh)
        return answer

    return found
