r"""From displacement fields to tracked points: displacements of markers on the surface and of targets inside the body.

A marker inside the body (a seed, a coil, a vessel) moves with the tetrahedron that contains it, as a target does. It
is inside if it lies deeper than the places of markers on the skin are known: than `SKIN_SHARE` of the body's extent and
than twice its noise. Near the skin both ways to move agree up to the strain times the depth.

Any other marker that does not lie on the triangles of the surface moves rigidly with the patch of surface around its
foot,

    u(marker) = u(foot) + (R - I) offset,      offset = reference place - foot,

where u is the displacement, the foot is the closest point of the surface, R the rotation that fits the motion of the
patch's nodes best (Kabsch), and I the identity. Fields are interpolated linearly between corner nodes, or quadratically
where the mid-edge nodes of ten-node elements are given too.
"""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray, float_array
from tissuereg._base.provenance import warn
from tissuereg._core import closest_rotations
from tissuereg.body.closest import barycentric
from tissuereg.body.locate import Locator, located_in, surface_of
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.errors import MarkerError

#: A marker farther from the surface than this share of the body's extent is refused: another frame or unit.
FARTHEST_SHARE = 0.5

#: A target this far outside the body, as a share of its extent, is refused; nearer ones move with the closest tet.
FARTHEST_TARGET_SHARE = 0.1

#: A mesh has the skin no finer than this share of the body's extent: its facets lie off a curved surface. No target is
#: warned of this little outside, and no marker this little below the skin is an inner one.
SKIN_SHARE = 0.01

#: A marker deeper than this many standard deviations of its noise is not on the skin.
_DEEP_STD = 2.0

#: Offsets below this many mm need no rotation.
_ON_SURFACE_MM = 1e-3

#: A place is beyond an edge of a triangle if its weight of the opposite corner is less than minus this.
_BEYOND = 1e-6


class MarkerObservation:
    """Observation operator of tracked markers: their displacement as a function of the displacement of nearby nodes.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the reference shape.
    reference : array_like of float, shape (n_markers, 3)
        Places of the markers on, near or inside the undeformed body, mm.
    names : sequence of str
        Names of the markers, used in error messages.
    quadratic : bool
        Whether displacement fields are those of ten-node elements: the mid-edge nodes, in the order of `mesh.edges`,
        follow the nodes of the mesh.
    like : MarkerObservation, optional
        Observation of the same markers on a mesh with the same tets and other coordinates. The foot of a marker (the
        closest point of the surface) then stays in the same triangle as there, or on the same edge or corner if the
        marker lies beyond that edge or corner; an inner marker stays in the same tet. This is needed for derivatives
        with respect to the shape of a mesh, because the closest triangle of a marker on an edge may change with any
        step.
    std : float or array_like of float, shape (n_markers,)
        Noise of the markers, mm, by which a marker may lie below the skin and still be on it.

    Raises
    ------
    MarkerError
        If a marker lies farther from the surface than half the body's extent.

    Attributes
    ----------
    nodes : ndarray of int64, shape (n_needed,)
        Indices of the nodes whose displacement `predict` needs.
    distance : ndarray of float64, shape (n_markers,)
        Distance of every marker from the surface, mm.
    inner : ndarray of bool, shape (n_markers,)
        Whether each marker is inside the body, and moves with the tet around it.
    """

    def __init__(
        self,
        mesh: Mesh,
        reference: Any,
        names: tuple[str, ...],
        *,
        quadratic: bool = False,
        like: "MarkerObservation | None" = None,
        std: Any = 0.0,
    ) -> None:
        places = float_array("reference", reference, (None, 3))
        if like is None:
            triangles, weights, feet = _closest_triangles(mesh, places)
            self._free = _free_corners(mesh.nodes[mesh.surface[triangles]], places, weights)
        else:
            triangles, self._free = like._triangles, like._free
            weights, feet = _feet_in(mesh.nodes[mesh.surface[triangles]], places, self._free)
        self._triangles: IntArray = triangles
        self._kept: tuple[FloatArray, list[tuple[IntArray, FloatArray]]] | None = None
        self.distance: FloatArray = np.linalg.norm(places - feet, axis=1)
        _check_distance(self.distance, names, mesh.extent)
        self._tets: IntArray = _tets_within(mesh, places, self.distance, std) if like is None else like._tets
        self.inner: BoolArray = np.asarray(self._tets >= 0)
        corners, weights = _cells(mesh, mesh.surface[triangles], weights, self._tets, places)
        feet_nodes, self._weights = _interpolation(mesh, corners, weights, quadratic)
        self._offset = np.where(self.inner[:, None], 0.0, places - feet)
        edges = np.linalg.norm(_differences(mesh.nodes[corners]), axis=2).max(axis=1)
        self._height = np.linalg.norm(self._offset, axis=1) / edges
        self._turned = np.flatnonzero(np.linalg.norm(self._offset, axis=1) > _ON_SURFACE_MM)
        patches = _patches(mesh, triangles[self._turned])
        self.nodes: IntArray = np.unique(np.concatenate([feet_nodes.ravel(), *patches]))
        self._foot_nodes, self._corners = np.searchsorted(self.nodes, feet_nodes), np.searchsorted(self.nodes, corners)
        self._patches = [np.searchsorted(self.nodes, patch) for patch in patches]
        # Patches are of corner nodes alone.
        self._members, self._arms = _padded(self._patches, mesh.nodes[np.minimum(self.nodes, mesh.n_nodes - 1)])

    @classmethod
    def of(cls, mesh: Mesh, markers: Markers) -> "MarkerObservation":
        """Return the observation operator of `markers` on `mesh`, for displacement fields of four-node elements."""
        return cls(mesh, markers.reference, markers.names, std=markers.std)

    @property
    def n_markers(self) -> int:
        """Number of markers."""
        return len(self._offset)

    def predict(self, displacement: FloatArray) -> FloatArray:
        """Return the displacement of every marker.

        Parameters
        ----------
        displacement : ndarray of float64, shape (..., n_needed, 3)
            Displacement in mm of the nodes listed in the attribute `nodes`; leading axes are kept.

        Returns
        -------
        ndarray of float64, shape (..., n_markers, 3)
            Displacement of every marker in mm.
        """
        moved = np.einsum("mc,...mcx->...mx", self._weights, displacement[..., self._foot_nodes, :])
        if len(self._turned):
            patches = displacement[..., self._members, :]
            self._add_rotation(moved, np.einsum("...mpx,mpy->...mxy", patches, self._levers))
        return np.asarray(moved)

    def points(self, n_nodes: int) -> Any:
        """Return the matrix that maps a displacement field to the point values that `predict_points` takes.

        Parameters
        ----------
        n_nodes : int
            Number of nodes of a displacement field.

        Returns
        -------
        scipy.sparse.csr_array, shape (n_points, n_nodes)
            Weights of the nodes. Its product with a field (n_nodes, 3) in mm has first one row per marker, the
            displacement of its foot (the closest point of the surface; of an inner marker its own place), then three
            rows for each marker off the surface: how the displacement varies along x, y and z across the patch of
            surface around the foot, in mm.
        """
        from scipy import sparse

        weights = [self._weights.ravel(), np.moveaxis(self._levers, 2, 1).ravel()]
        nodes = [self.nodes[self._foot_nodes].ravel(), np.repeat(self.nodes[self._members], 3, axis=0).ravel()]
        lengths = [
            np.full(self.n_markers, self._weights.shape[1]),
            np.full(3 * len(self._turned), self._members.shape[1]),
        ]
        rows = np.repeat(np.arange(self.n_markers + 3 * len(self._turned)), np.concatenate(lengths))
        shape = (self.n_markers + 3 * len(self._turned), n_nodes)
        found = sparse.coo_array((np.concatenate(weights), (rows, np.concatenate(nodes))), shape)
        return sparse.csr_array(found)

    def predict_points(self, moved: FloatArray) -> FloatArray:
        """Return the markers' displacement (..., n_markers, 3) from the matrix of `points` times a field, mm."""
        feet: FloatArray = moved[..., : self.n_markers, :].copy()
        if len(self._turned):
            across = moved[..., self.n_markers :, :].reshape(*moved.shape[:-2], len(self._turned), 3, 3)
            self._add_rotation(feet, np.swapaxes(across, -1, -2))
        return feet

    @cached_property
    def _levers(self) -> FloatArray:
        """Lever arms (m, p, 3) of nodes about the centroid of each patch, divided by a length: no unit."""
        squares = np.einsum("mpx,mpx->m", self._arms, self._arms)
        return np.asarray(self._arms / np.sqrt(squares * self._arms.shape[1])[:, None, None])

    @cached_property
    def _at_rest(self) -> FloatArray:
        """Sums (m, 3, 3), in mm, over each patch of surface of lever arm times scaled lever arm, at rest."""
        return np.asarray(np.einsum("mpx,mpy->mxy", self._arms, self._levers))

    def _add_rotation(self, moved: FloatArray, across: FloatArray) -> None:
        """Add to `moved` (..., n_markers, 3), displacements of the feet in mm, the motion of markers about their feet.

        `across` (..., m, 3, 3): sums of displacement times scaled lever arm over the patch of each of the m markers off
        the surface, in mm. `moved` is changed in place.
        """
        turned = _rotations(self._at_rest + across)
        moved[..., self._turned, :] += np.einsum("...mxy,my->...mx", turned - np.eye(3), self._offset[self._turned])

    def variation(self, displacement: FloatArray) -> FloatArray:
        """Return how much the displacement varies across the surface triangle under every marker, or the tet around it.

        Parameters
        ----------
        displacement : ndarray of float64, shape (n_needed, 3)
            Displacement in mm of the nodes listed in the attribute `nodes`.

        Returns
        -------
        ndarray of float64, shape (n_markers,)
            Largest difference between the displacements of two corners of the closest triangle or tet, mm, times 1 plus
            the distance from the surface of a marker that is not inner over the longest edge of the triangle.
        """
        differences = _differences(displacement[self._corners])
        return np.asarray((1.0 + self._height) * np.linalg.norm(differences, axis=2).max(axis=1))

    def jacobian(self, displacement: FloatArray) -> FloatArray:
        """Return the derivative of the displacement of every marker with respect to that of the nodes.

        Parameters
        ----------
        displacement : ndarray of float64, shape (n_needed, 3)
            Displacement in mm of the nodes listed in the attribute `nodes`, at which the derivative is taken.

        Returns
        -------
        ndarray of float64, shape (n_markers, 3, n_needed, 3)
            Dimensionless derivatives: by central differences for the rotation of markers off the surface, exact
            otherwise.
        """
        slopes = np.zeros((self.n_markers, 3, len(self.nodes), 3))
        for marker, (members, weights) in enumerate(self._slopes(displacement)):
            for axis in range(3):
                np.add.at(slopes[marker, axis], members, weights[axis])
        return slopes

    def rows(self, displacement: FloatArray) -> list[tuple[IntArray, FloatArray]]:
        """Return the derivative of each coordinate of each marker's displacement as a sparse row over nodes.

        Parameters
        ----------
        displacement : ndarray of float64, shape (n_needed, 3)
            Displacement in mm of the nodes listed in the attribute `nodes`, at which the derivative is taken.

        Returns
        -------
        list of (ndarray of int64 (k,), ndarray of float64 (k, 3))
            One entry for x, y and z of each marker in turn, ``3 n_markers`` in all: indices of nodes of the mesh, and
            the dimensionless derivatives with respect to their displacements. A node may be listed twice; its
            derivatives are then to be added.
        """
        found = []
        for members, weights in self._slopes(displacement):
            found += [(self.nodes[members], weights[axis]) for axis in range(3)]
        return found

    def rows_of(self, field: FloatArray) -> list[tuple[IntArray, FloatArray]]:
        """Return `rows` at a displacement of all nodes (n_nodes, 3), mm, kept for the next call with the same array."""
        kept = self._kept
        if kept is None or kept[0] is not field:
            kept = self._kept = (field, self.rows(field[self.nodes]))
        return kept[1]

    def _slopes(self, displacement: FloatArray) -> Iterator[tuple[IntArray, FloatArray]]:
        """Yield for every marker the nodes on which its displacement depends, and the derivative with respect to these.

        `displacement` (n_needed, 3): displacement of `nodes` in mm. Yields positions (k,) in the attribute `nodes`, and
        dimensionless derivatives (3, k, 3): marker coordinate, node, node coordinate.
        """
        turned = {int(marker): row for row, marker in enumerate(self._turned)}
        for marker in range(self.n_markers):
            members = self._foot_nodes[marker]
            weights = np.einsum("c,xy->xcy", self._weights[marker], np.eye(3))
            if marker in turned:
                patch = self._patches[turned[marker]]
                arms, here = self._arms[turned[marker]][: len(patch)], displacement[patch]
                step = 1e-5 * float(np.ptp(arms, axis=0).max())
                nudges = step * np.eye(3 * len(patch)).reshape(-1, len(patch), 3)
                nudged = _rotations(np.swapaxes(arms + np.stack([here + nudges, here - nudges]), -1, -2) @ arms)
                change = (nudged[0] - nudged[1]) / (2.0 * step)
                by_rotation = np.moveaxis((change @ self._offset[marker]).reshape(len(patch), 3, 3), -1, 0)
                members = np.concatenate([members, patch])
                weights = np.concatenate([weights, by_rotation], axis=1)
            yield members, weights


class TargetObservation:
    """Observation operator of targets: their displacement, interpolated between the nodes of the tets around them.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the reference shape.
    targets : mapping of str to array_like of float, shape (3,)
        Places in the undeformed body, mm, by name.
    quadratic : bool
        Whether displacement fields are those of ten-node elements: the mid-edge nodes, in the order of `mesh.edges`,
        follow the nodes of the mesh.

    Raises
    ------
    MarkerError
        If a target lies outside the body by more than a tenth of its extent, or is not finite.

    Attributes
    ----------
    nodes : ndarray of int64, shape (k,)
        Indices of the nodes whose displacement `predict` needs.
    """

    def __init__(self, mesh: Mesh, targets: Mapping[str, Any], *, quadratic: bool = False) -> None:
        self.names = tuple(targets)
        self.reference: FloatArray = np.array(
            [float_array(f"targets[{n!r}]", p, (3,)) for n, p in targets.items()]
        ).reshape(-1, 3)
        locator = located_in(mesh)
        found = locator.inside(self.reference)
        located = [
            one or _closest_tet(locator, name, point)
            for one, name, point in zip(found, self.names, self.reference, strict=True)
        ]
        corners = np.array([mesh.tets[tet] for tet, _ in located], dtype=np.int64).reshape(-1, 4)
        weights = np.array([weights for _, weights in located]).reshape(-1, 4)
        nodes, self._weights = _interpolation(mesh, corners, weights, quadratic)
        self.nodes: IntArray = np.unique(nodes)
        self._corners = np.searchsorted(self.nodes, nodes)

    def predict(self, displacement: FloatArray) -> FloatArray:
        """Return the targets' displacement (..., n_targets, 3) from that of the nodes `nodes` (..., k, 3), mm."""
        return np.asarray(np.einsum("tc,...tcx->...tx", self._weights, displacement[..., self._corners, :]))

    def points(self, n_nodes: int) -> Any:
        """Return the sparse matrix (n_targets, n_nodes) of weights that interpolates fields at the targets."""
        from scipy import sparse

        rows = np.repeat(np.arange(len(self.names)), self._corners.shape[1])
        columns = self.nodes[self._corners].ravel()
        return sparse.csr_array((self._weights.ravel(), (rows, columns)), (len(self.names), n_nodes))

    def rows(self) -> list[tuple[IntArray, FloatArray]]:
        """Return the derivative of each coordinate of each target's displacement as a sparse row over nodes.

        The list has one entry for x, y and z of each target in turn, ``3 n_targets`` in all: indices of nodes (k,), and
        dimensionless derivatives with respect to their displacements (k, 3).
        """
        return [
            (self.nodes[corners], np.outer(weights, np.eye(3)[axis]))
            for corners, weights in zip(self._corners, self._weights, strict=True)
            for axis in range(3)
        ]


def _closest_tet(locator: Locator, name: str, point: FloatArray) -> tuple[int, FloatArray]:
    """Return the tet closest to a target (3,), mm, outside the body, and barycentric weights (4,)."""
    if not np.isfinite(point).all():
        message = f"target '{name}' must be finite, got {point.tolist()}"
        raise MarkerError(message, where=name)
    tet, weights, gap = locator.closest(point)
    if gap > FARTHEST_TARGET_SHARE * locator.extent:
        message = f"target '{name}' must lie in the undeformed body; {point.tolist()} is {gap:.1f} mm outside"
        raise MarkerError(message, where=name)
    if gap > SKIN_SHARE * locator.extent:
        text = f"target '{name}' lies {gap:.2g} mm outside the mesh; it moves with the closest tet"
        warn(text)
    return tet, weights


def _tets_within(mesh: Mesh, places: FloatArray, distance: FloatArray, std: Any) -> IntArray:
    """Return the tet that contains each place (n,), by index; -1 outside, and no deeper than the skin is known.

    `places` (n, 3): mm; `distance` (n,): distance from the surface, mm; `std`: noise, mm, one number or (n,).
    """
    tets = np.full(len(places), -1, np.int64)
    deep = np.flatnonzero(distance > np.maximum(SKIN_SHARE * mesh.extent, _DEEP_STD * np.asarray(std)))
    if len(deep):
        locator = located_in(mesh)
        for marker in deep:
            found = locator.around(places[marker])
            tets[marker] = -1 if found is None else found[0]
    return tets


def _cells(
    mesh: Mesh, triangles: IntArray, weights: FloatArray, tets: IntArray, places: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the corners and barycentric weights of the triangle of each foot, or of the tet around an inner place.

    `triangles` int64 (n, 3), `weights` (n, 3): of the feet; `tets` int64 (n,): tets around inner places, -1 elsewhere;
    `places` (n, 3): mm. Result: (n, 3) if no place is inside; else (n, 4), where a triangle's first corner is repeated
    with a weight of zero.
    """
    inner = np.flatnonzero(tets >= 0)
    if not len(inner):
        return triangles, weights
    corners, shares = np.zeros((len(tets), 4), np.int64), np.zeros((len(tets), 4))
    corners[:, :3], corners[:, 3], shares[:, :3] = triangles, triangles[:, 0], weights
    corners[inner] = mesh.tets[tets[inner]]
    edges = np.moveaxis(mesh.nodes[corners[inner, 1:]] - mesh.nodes[corners[inner, :1]], 1, 2)
    last = np.linalg.solve(edges, (places[inner] - mesh.nodes[corners[inner, 0]])[..., None])[..., 0]
    shares[inner] = np.concatenate([1.0 - last.sum(axis=1, keepdims=True), last], axis=1)
    return corners, shares


def _differences(values: FloatArray) -> FloatArray:
    """Return the differences (n, p, 3) between any two of the values (n, k, 3) at the corners of n cells."""
    first, second = np.triu_indices(values.shape[1], 1)
    return np.asarray(values[:, first] - values[:, second])


def _interpolation(mesh: Mesh, corners: IntArray, weights: FloatArray, quadratic: bool) -> tuple[IntArray, FloatArray]:
    """Return the nodes and weights that interpolate a displacement at n points, from barycentric weights.

    `corners`, `weights` (n, 3) or (n, 4): node indices of the triangle or tet of each point, and barycentric weights.
    For linear elements these are returned as they are. For quadratic ones mid-edge nodes are appended along the second
    axis, and the weights are the shape functions of second order, ``l_a (2 l_a - 1)`` at corner a and ``4 l_a l_b``
    between corners a and b, where ``l`` are the barycentric weights.
    """
    if not quadratic:
        return corners, weights
    first, second = np.triu_indices(corners.shape[1], 1)
    a, b = corners[:, first], corners[:, second]
    # Edges are sorted by their lower, then their upper end.
    keys = mesh.edges[:, 0] * mesh.n_nodes + mesh.edges[:, 1]
    found = np.searchsorted(keys, np.minimum(a, b) * mesh.n_nodes + np.maximum(a, b))
    # A corner that is repeated has no edge with itself, and no weight.
    middles = mesh.n_nodes + np.minimum(found, len(keys) - 1)
    at_corners, between = weights * (2.0 * weights - 1.0), 4.0 * weights[:, first] * weights[:, second]
    return np.concatenate([corners, middles], axis=1), np.concatenate([at_corners, between], axis=1)


def _closest_triangles(mesh: Mesh, places: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    found = surface_of(mesh).find(places)
    weights = np.clip(barycentric(found.feet, mesh.nodes[mesh.surface[found.triangles]]), 0.0, None)
    return found.triangles, np.asarray(weights / weights.sum(axis=1, keepdims=True)), found.feet


def _free_corners(corners: FloatArray, places: FloatArray, weights: FloatArray) -> BoolArray:
    """Return a mask (n, 3) of the corners that span the face, edge or corner of its triangle on which each foot lies.

    `corners` (n, 3, 3), `places` (n, 3): corners of the closest triangle of each place, and places, mm; `weights` (n,
    3): barycentric weights of the foot, the closest point. All corners are marked unless the place lies beyond an edge.
    """
    beyond = (barycentric(places, corners) < -_BEYOND).any(axis=1, keepdims=True)
    return np.logical_or(~beyond, weights > 0.0)


def _feet_in(corners: FloatArray, places: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the feet of places on the planes, lines or points through the marked corners of their triangles.

    `corners` (n, 3, 3), `places` (n, 3): mm; `free` (n, 3): mask of the corners to use. Result: barycentric weights (n,
    3) and closest points (n, 3) in mm.
    """
    weights = barycentric(places, corners)
    for marker in np.flatnonzero(~free.all(axis=1)):
        ends = np.flatnonzero(free[marker])
        first, last = corners[marker, ends[0]], corners[marker, ends[-1]]
        along = last - first
        share = (places[marker] - first) @ along / max(float(along @ along), np.finfo(float).tiny)
        weights[marker] = 0.0
        weights[marker, ends] = (1.0 - share, share) if len(ends) == 2 else 1.0
    return weights, np.einsum("nc,ncx->nx", weights, corners)


def _patches(mesh: Mesh, triangles: IntArray) -> list[IntArray]:
    """Return for each surface triangle, given by number, the indices of the nodes of all triangles that touch it."""
    patches = []
    for triangle in triangles:
        touching = np.isin(mesh.surface, mesh.surface[triangle]).any(axis=1)
        patches.append(np.unique(mesh.surface[touching]))
    return patches


def _padded(patches: list[IntArray], places: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the nodes (m, p) of m patches of surface, and lever arms (m, p, 3), mm, to them from the patch's centroid.

    `patches`: indices into `places` (n, 3), mm, for each patch; p is the size of the largest patch. Shorter patches
    repeat nodes, with lever arms of zero.
    """
    longest = max((len(patch) for patch in patches), default=0)
    members = np.zeros((len(patches), longest), np.int64)
    arms = np.zeros((len(patches), longest, 3))
    for row, patch in enumerate(patches):
        members[row] = np.resize(patch, longest)
        arms[row, : len(patch)] = places[patch] - places[patch].mean(axis=0)
    return members, arms


def _rotations(correlation: FloatArray) -> FloatArray:
    """Return the rotation matrices R (..., 3, 3) closest to matrices C (..., 3, 3), one for each patch of surface.

    C is the sum over a patch's nodes of (moved lever arm) (lever arm at rest)', where ' is the transpose.
    """
    flat = np.ascontiguousarray(correlation, np.float64).reshape(-1, 9)
    return np.asarray(closest_rotations(flat).reshape(correlation.shape))


def _check_distance(distance: FloatArray, names: tuple[str, ...], extent: float) -> None:
    far = int(np.argmax(distance)) if len(distance) else 0
    if len(distance) and distance[far] > FARTHEST_SHARE * extent:
        message = (
            f"every marker must sit on or near the undeformed surface: marker '{names[far]}' is {distance[far]:.1f} mm "
            f"away from a body of extent {extent:.1f} mm; check frame and units"
        )
        raise MarkerError(message, where=names[far])
