"""Where the body is stiffer or softer: factors on Young's modulus that can be evaluated at any point."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.fields import number, numbers
from tissuereg.body.mesh import Mesh
from tissuereg.experiment.effects.base import Effect, Vector
from tissuereg.experiment.experiment import Experiment

#: Rows of the triangular lattice of sample points in a tet: 6 give 56 points.
_LATTICE_ROWS = 6

#: Rows of sample points in a triangle of the surface, and how many nearest ones give a point's candidate triangles:
#: distances are then accurate to some hundredths of an edge.
_TRIANGLE_ROWS = 4
_CANDIDATES = 4


class SharpRegion(Protocol):
    """A part of the body with a sharp edge."""

    @property
    def steepness(self) -> float:
        """Largest change of `depth` along a path of 1 mm."""

    def depth(self, points: FloatArray) -> FloatArray:
        """Return how deep points (..., 3) lie inside the region in mm, negative outside."""

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the depth (n, n_points) of points in some tets (n,) from their barycentric weights (n_points, 4)."""


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid along the axes.

    Parameters
    ----------
    centre : tuple of float
        mm.
    semi_axes : tuple of float
        mm.
    """

    centre: Vector
    semi_axes: Vector

    @property
    def steepness(self) -> float:
        """Largest change of the estimated depth along a path of 1 mm."""
        return 2.0 * max(self.semi_axes) / min(self.semi_axes)

    def depth(self, points: FloatArray) -> FloatArray:
        """Return how deep points (..., 3) lie inside, mm, negative outside.

        It is exact for a ball, and to first order near the edge otherwise.
        """
        offset = points - np.asarray(self.centre)
        axes = np.asarray(self.semi_axes)
        size = np.linalg.norm(offset / axes, axis=-1)
        slope = np.linalg.norm(offset / axes**2, axis=-1)
        inner = min(self.semi_axes)
        return np.asarray(np.where(slope > 0, size * (1 - size) / np.where(slope > 0, slope, 1.0), inner))

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the depth of lattice points in tets, (n_tets, n_points), mm, negative outside the ellipsoid.

        `tets` int64 (n_tets,): numbers of tets; `weights` (n_points, 4): barycentric weights of the points in every
        tet.
        """
        return self.depth(np.einsum("pc,tcx->tpx", weights, mesh.nodes[mesh.tets[tets]]))


class OuterLayer:
    """The part of the body that lies less than a thickness below the free surface.

    Parameters
    ----------
    mesh : Mesh
        Reference shape; boundary triangles with all nodes in its set ``fixed`` are no free surface.
    thickness : float
        mm.
    """

    steepness = 1.0

    def __init__(self, mesh: Mesh, thickness: float) -> None:
        self._mesh = mesh
        self._thickness = thickness

    def depth(self, points: FloatArray) -> FloatArray:
        """Return how far points (..., 3) of the body lie above the layer's inner face, mm."""
        return np.asarray(self._thickness - _surface_of(self._mesh).distance(points))

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the depth of lattice points in tets, (n_tets, n_points), mm.

        It is linear between a tet's corners and its centre. `tets` int64 (n_tets,): numbers of tets; `weights`
        (n_points, 4): barycentric weights of the points in every tet.
        """
        surface = _surface_of(self._mesh)
        inner = weights.min(axis=1)
        to_corners = (weights - inner[:, None]) @ surface.of_nodes[mesh.tets[tets]].T
        return np.asarray(self._thickness - to_corners.T - 4.0 * inner * surface.of_centres[tets, None])


class _FreeSurface:
    """Distances from the free surface of a body, mm."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import KDTree

        held = np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)
        self._triangles = mesh.nodes[mesh.surface[~held]]
        rows = range(_TRIANGLE_ROWS + 1)
        weights = np.array([(a, b, _TRIANGLE_ROWS - a - b) for a in rows for b in rows if a + b <= _TRIANGLE_ROWS])
        samples = np.einsum("sc,tcx->tsx", weights / _TRIANGLE_ROWS, self._triangles).reshape(-1, 3)
        self._owner = np.repeat(np.arange(len(self._triangles)), len(weights))
        self._tree = KDTree(samples)
        self.of_nodes = self.distance(mesh.nodes)
        self.of_centres = self.distance(mesh.nodes[mesh.tets].mean(axis=1))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (...), mm, of points (..., 3) from the triangles of their nearest surface samples."""
        import trimesh

        closest: Any = trimesh.triangles.closest_point  # trimesh leaves this function without annotations
        flat = points.reshape(-1, 3)
        _, nearest = self._tree.query(flat, k=_CANDIDATES)
        candidates = self._triangles[self._owner[nearest]]
        feet = [closest(candidates[:, i], flat) for i in range(_CANDIDATES)]
        distance = np.min([np.linalg.norm(foot - flat, axis=1) for foot in feet], axis=0)
        return np.asarray(distance.reshape(points.shape[:-1]))


@lru_cache(maxsize=2)
def _surface_of(mesh: Mesh) -> _FreeSurface:
    """Return the free surface of a mesh; layers of one body differ in thickness alone."""
    return _FreeSurface(mesh)


def share_inside(region: SharpRegion, mesh: Mesh, n_points: int = 1) -> FloatArray:
    """Return the share of every tet's volume, or of the volume around each of its points, that lies inside a region.

    Each tet that the edge may cross is sampled at a lattice of points, and the edge is smoothed over their spacing: the
    share is continuous in the region's place and size.

    Parameters
    ----------
    region : SharpRegion
        With a sharp edge.
    mesh : Mesh
        Reference shape.
    n_points : {1, 4}
        Quadrature points of an element; each of four takes the quarter of the tet that is nearest to its corner.

    Returns
    -------
    ndarray of float64, shape (n_tets,) or (n_tets, 4)
        From 0 to 1.
    """
    corners = mesh.nodes[mesh.tets]
    reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    weights = _lattice()
    width = np.cbrt(mesh.volumes / len(weights))
    depth = region.lattice_depth(mesh, np.arange(mesh.n_tets), np.full((1, 4), 0.25))
    share = np.repeat((depth > 0).astype(np.float64), n_points, axis=1)
    crossed = np.flatnonzero(np.abs(depth[:, 0]) <= region.steepness * reach + width)
    inside = np.clip(0.5 + region.lattice_depth(mesh, crossed, weights) / width[crossed, None], 0.0, 1.0)
    share[crossed] = inside @ _parts(weights, n_points)
    return share[:, 0] if n_points == 1 else share


def _parts(weights: FloatArray, n_points: int) -> FloatArray:
    """Return the weight of each lattice point for each quadrature point; columns sum to 1."""
    if n_points == 1:
        return np.full((len(weights), 1), 1.0 / len(weights))
    # Points at the same distance from several corners are shared equally among them.
    nearest = np.isclose(weights, weights.max(axis=1, keepdims=True)).astype(np.float64)
    nearest /= nearest.sum(axis=1, keepdims=True)
    return np.asarray(nearest / nearest.sum(axis=0))


@dataclass(frozen=True, kw_only=True)
class Inclusion(Effect):
    """An ellipsoid along the axes whose modulus is `contrast` times that around it."""

    id: ClassVar[str] = "inclusion"
    repeatable: ClassVar[bool] = True
    centre_mm: Vector = numbers("centre", 3)
    semi_axes_mm: Vector = numbers("half-axes along x, y and z", 3, above=0.0)
    contrast: float = number("modulus inside over outside", above=0.0)

    def applied(self, experiment: Experiment, element: str) -> Experiment:
        """Return the experiment with the inclusion's factor on the modulus."""
        return _stiffened(experiment, Ellipsoid(self.centre_mm, self.semi_axes_mm), self.contrast, element)


@dataclass(frozen=True, kw_only=True)
class Layer(Effect):
    """An outer layer below the free surface whose modulus is `contrast` times that of the core."""

    id: ClassVar[str] = "layer"
    thickness_mm: float = number("depth below the free surface, which excludes held faces", above=0.0)
    contrast: float = number("modulus inside over outside", above=0.0)

    def applied(self, experiment: Experiment, element: str) -> Experiment:
        """Return the experiment with the layer's factor on the modulus."""
        return _stiffened(experiment, OuterLayer(experiment.mesh, self.thickness_mm), self.contrast, element)


def _stiffened(experiment: Experiment, region: SharpRegion, contrast: float, element: str) -> Experiment:
    factor = 1.0 + (contrast - 1.0) * share_inside(region, experiment.mesh, 4 if element == "tet10" else 1)
    return replace(experiment, material=experiment.material.scaled(factor))


def _lattice() -> FloatArray:
    """Return barycentric weights of points spread evenly through a tet, shape (n_points, 4)."""
    rows = range(_LATTICE_ROWS)
    steps = [(a, b, c) for a in rows for b in rows for c in rows if a + b + c < _LATTICE_ROWS]
    assert len(steps) == math.comb(_LATTICE_ROWS + 2, 3)
    inner = (np.array(steps, np.float64) + 0.25) / (_LATTICE_ROWS)
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
