"""A tetrahedral mesh in its reference shape: nodes, tets, named node sets."""

import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property, wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from tissuereg._base.arguments import check_choice, named, real, text
from tissuereg._base.arrays import FloatArray, IntArray, float_array, frozen, index_array
from tissuereg._core import check_mesh, surface_triangles, tet_volumes
from tissuereg.errors import MeshError, UnitError

#: Frames of a patient: x to the left, y to the back, z to the head; or x to the right, y to the front, z to the head.
PATIENT_FRAMES = ("LPS", "RAS")

#: Extents, in mm, outside which a body is taken to be in other units.
PLAUSIBLE_EXTENT_MM = (1.0, 3000.0)


class Mesh:
    """Tetrahedra in the undeformed shape.

    Parameters
    ----------
    nodes : array_like of float, shape (n_nodes, 3)
        Coordinates in mm.
    tets : array_like of int, shape (n_tets, 4)
        Node indices; positive volume in the order (a, b, c, d) with d on the side of (b-a) x (c-a).
    node_sets : mapping of str to array_like of int, optional
        Named sets of nodes. The set ``fixed`` is held.
    frame : {"LPS", "RAS"}, optional
        Declared patient frame of the coordinates; nothing is computed from it, and files that state a frame are written
        in it.

    Raises
    ------
    ShapeError
        If an array has another shape or dtype.
    MeshError
        If a coordinate is not finite, an index out of range, a tet inverted or degenerate, a node loose; or if `frame`
        is none of the two.
    UnitError
        If the body's extent cannot be millimetres.

    Examples
    --------
    >>> mesh = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> mesh
    Mesh(4 nodes, 1 tets, node sets: fixed (3))
    """

    def __init__(
        self, nodes: Any, tets: Any, node_sets: Mapping[str, Any] | None = None, frame: str | None = None
    ) -> None:
        if frame is not None:
            check_choice("frame", frame, PATIENT_FRAMES, MeshError)
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
        """Indices of the held nodes, the set ``fixed``.

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
            Its nodes.

        Returns
        -------
        Mesh
            Shares nodes and tets with this one.
        """
        text("name", name, error=MeshError)
        return Mesh(self.nodes, self.tets, {**self.node_sets, name: indices}, self.frame)

    def in_frame(self, frame: str | None) -> "Mesh":
        """Return the same mesh with its coordinates declared to be in a frame; no coordinate is changed.

        Parameters
        ----------
        frame : {"LPS", "RAS"} or None
            Frame of a patient; None is an unknown one.

        Returns
        -------
        Mesh
            Shares nodes and tets with this one.
        """
        return Mesh(self.nodes, self.tets, self.node_sets, frame)

    @cached_property
    def extent(self) -> float:
        """Largest extent along an axis, mm."""
        return float(np.max(np.ptp(self.nodes, axis=0)))

    @cached_property
    def surface(self) -> IntArray:
        """Boundary triangles, outward normals, shape (n_triangles, 3)."""
        return frozen(surface_triangles(self.nodes, self.tets))

    @cached_property
    def surface_nodes(self) -> IntArray:
        """Sorted indices of the nodes on the boundary, shape (n,)."""
        return frozen(np.unique(self.surface))

    def surface_nodes_within(self, centre: Any, radius: float) -> IntArray:
        """Return the surface nodes in a ball.

        Parameters
        ----------
        centre : array_like of float, shape (3,)
            mm.
        radius : float
            mm.

        Returns
        -------
        ndarray of int64, shape (n,)
            Sorted; may be empty.
        """
        distance = np.linalg.norm(self.nodes[self.surface_nodes] - float_array("centre", centre, (3,)), axis=1)
        return np.asarray(self.surface_nodes[distance <= real("radius", radius, error=MeshError)])

    @cached_property
    def edges(self) -> IntArray:
        """Edges of the tets, each once, lower index first, shape (n_edges, 2)."""
        pairs = self.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
        return frozen(np.unique(np.sort(pairs, axis=1), axis=0))

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of every tet in mm^3, shape (n_tets,)."""
        return frozen(tet_volumes(self.nodes, self.tets))

    def digest(self) -> str:
        """Return a fingerprint of nodes, tets and held nodes.

        Returns
        -------
        str
            SHA-256, hexadecimal. Coordinates are rounded to 1e-6 mm, so that text formats preserve it.
        """
        digest = hashlib.sha256()
        digest.update(np.round(self.nodes * 1e6).astype("<i8").tobytes())
        digest.update(self.tets.astype("<i8").tobytes())
        digest.update(self.node_sets.get("fixed", np.empty(0, np.int64)).astype("<i8").tobytes())
        return digest.hexdigest()


def node_normals(mesh: Mesh, areas: FloatArray) -> FloatArray:
    """Return unit normals at the nodes of a surface: means over the triangles that meet there, by their areas.

    `areas` (n_triangles, 3): outward normal of every triangle of `Mesh.surface`, as long as its area, in any unit.
    Result: (n_nodes, 3), zero inside.
    """
    total = np.zeros_like(mesh.nodes)
    for corner in range(3):
        np.add.at(total, mesh.surface[:, corner], areas)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny))


def free_surface(mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """Return the triangles (k, 3) of the surface that are not held, and the share (k,) of each in their area."""
    held = np.zeros(mesh.n_nodes, dtype=bool)
    held[mesh.fixed_nodes] = True
    free = mesh.surface[~held[mesh.surface].all(axis=1)]
    corners = mesh.nodes[free]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return free, areas / areas.sum()


def det_f(mesh: Mesh, displacement: FloatArray) -> FloatArray:
    """Return the volume ratio of every tet under a displacement of its corners.

    `mesh`: reference shape; `displacement` (..., n_nodes, 3): displacement in mm; leading axes are kept. Result: (...,
    n_tets), det F, dimensionless; not positive where a tet is inverted.
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
    """Return a function that computes its value once for every mesh, whose arrays never change.

    Two threads that call it at the same time may both compute it; both values are the same.
    """
    kept: WeakKeyDictionary[Mesh, Made] = WeakKeyDictionary()

    @wraps(make)
    def found(mesh: Mesh) -> Made:
        answer = kept.get(mesh)
        if answer is None:
            answer = kept[mesh] = make(mesh)
        return answer

    return found
