"""Effects that make a region of the body stiffer or softer: factors on Young's modulus, defined at any point."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Protocol

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg._base.fields import number, numbers
from tissuereg.body.closest import closest_on_triangles
from tissuereg.body.mesh import Mesh, free_triangles
from tissuereg.experiment.effects.base import Effect, Vector
from tissuereg.experiment.experiment import Experiment

#: Rows of the triangular lattice of sample points in a tet: 6 give 56 points.
_LATTICE_ROWS = 6

#: Rows of sample points in a triangle of the surface, and how many nearest ones give a point's candidate triangles:
#: distances are then accurate to some hundredths of an edge.
_TRIANGLE_ROWS = 4
_CANDIDATES = 4


class SharpRegion(Protocol):
    """Protocol of a region of the body with a sharp edge, described by a depth function that is zero at the edge."""

    @property
    def steepness(self) -> float:
        """Largest change of `depth` in mm along a path of 1 mm."""

    def depth(self, points: FloatArray) -> FloatArray:
        """Return the depth (...) in mm of points (..., 3) in mm below the edge of the region, negative outside."""

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the depth (n, n_points), mm, of points in tets (n,), from barycentric weights (n_points, 4)."""


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoidal region whose axes lie along x, y and z.

    Parameters
    ----------
    centre : tuple of float
        Centre, mm.
    semi_axes : tuple of float
        Half-axes along x, y and z, mm.
    """

    centre: Vector
    semi_axes: Vector

    @property
    def steepness(self) -> float:
        """Upper bound of the change of the estimated depth in mm along a path of 1 mm."""
        return 2.0 * max(self.semi_axes) / min(self.semi_axes)

    def depth(self, points: FloatArray) -> FloatArray:
        """Return the depth (...) in mm of points (..., 3) in mm below the ellipsoid's surface, negative outside.

        It is exact for a ball, and to first order near the surface otherwise.
        """
        offset = points - np.asarray(self.centre)
        axes = np.asarray(self.semi_axes)
        size = np.linalg.norm(offset / axes, axis=-1)
        slope = np.linalg.norm(offset / axes**2, axis=-1)
        inner = min(self.semi_axes)
        return np.asarray(np.where(slope > 0, size * (1 - size) / np.where(slope > 0, slope, 1.0), inner))

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the depth of points in tets, (n_tets, n_points), mm, negative outside the ellipsoid.

        `tets` int64 (n_tets,): indices of the tets; `weights` (n_points, 4): barycentric weights of the points, the
        same in every tet.
        """
        return self.depth(np.einsum("pc,tcx->tpx", weights, mesh.nodes[mesh.tets[tets]]))


class OuterLayer:
    """The region of the body that lies less than a thickness below its free surface.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the reference shape. Boundary triangles whose nodes are all in its node set ``fixed`` do not belong to
        the free surface.
    thickness : float
        Thickness of the layer, mm.
    """

    steepness = 1.0

    def __init__(self, mesh: Mesh, thickness: float) -> None:
        self._mesh = mesh
        self._thickness = thickness

    def depth(self, points: FloatArray) -> FloatArray:
        """Return the distance (...), mm, of points (..., 3), mm, above the layer's inner face; negative below."""
        return np.asarray(self._thickness - _surface_of(self._mesh).distance(points))

    def lattice_depth(self, mesh: Mesh, tets: IntArray, weights: FloatArray) -> FloatArray:
        """Return the distance of points in tets above the layer's inner face, (n_tets, n_points), mm; negative below.

        It is interpolated linearly between a tet's corners and its centre. `tets` int64 (n_tets,): indices of the tets;
        `weights` (n_points, 4): barycentric weights of the points, the same in every tet.
        """
        surface = _surface_of(self._mesh)
        inner = weights.min(axis=1)
        to_corners = (weights - inner[:, None]) @ surface.of_nodes[mesh.tets[tets]].T
        return np.asarray(self._thickness - to_corners.T - 4.0 * inner * surface.of_centres[tets, None])


class _FreeSurface:
    """Distances in mm from a body's free surface: `of_nodes` (n_nodes,), `of_centres` of tets (n_tets,), of points."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import KDTree

        self._triangles = mesh.nodes[mesh.surface[free_triangles(mesh, mesh.fixed_nodes)]]
        rows = range(_TRIANGLE_ROWS + 1)
        weights = np.array([(a, b, _TRIANGLE_ROWS - a - b) for a in rows for b in rows if a + b <= _TRIANGLE_ROWS])
        samples = np.einsum("sc,tcx->tsx", weights / _TRIANGLE_ROWS, self._triangles).reshape(-1, 3)
        self._owner = np.repeat(np.arange(len(self._triangles)), len(weights))
        self._tree = KDTree(samples)
        self.of_nodes = self.distance(mesh.nodes)
        self.of_centres = self.distance(mesh.nodes[mesh.tets].mean(axis=1))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (...), mm, of points (..., 3), mm, from the triangles of the nearest surface samples."""
        flat = points.reshape(-1, 3)
        _, nearest = self._tree.query(flat, k=_CANDIDATES)
        feet = closest_on_triangles(flat[:, None], self._triangles[self._owner[nearest]])
        distance = np.linalg.norm(feet - flat[:, None], axis=2).min(axis=1)
        return np.asarray(distance.reshape(points.shape[:-1]))


@lru_cache(maxsize=2)
def _surface_of(mesh: Mesh) -> _FreeSurface:
    """Return the distances from the free surface of a mesh, which are kept for the two meshes used last."""
    return _FreeSurface(mesh)


def share_inside(region: SharpRegion, mesh: Mesh, n_points: int = 1) -> FloatArray:
    """Return the share of each tet's volume, or of the volume at each of its quadrature points, inside a region.

    Each tet that the edge may cross is sampled at a lattice of points, and the edge is smoothed over their spacing: the
    share is continuous in the region's place and size.

    Parameters
    ----------
    region : SharpRegion
        Region with a sharp edge.
    mesh : Mesh
        Mesh in the reference shape.
    n_points : {1, 4}
        Number of quadrature points of an element. Each of four stands for the quarter of the tet that is nearest to its
        corner.

    Returns
    -------
    ndarray of float64, shape (n_tets,) or (n_tets, 4)
        Shares of the volume, from 0 to 1.
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
    """Return the weight of each sample for each quadrature point, (n_samples, n_points); columns sum to 1."""
    if n_points == 1:
        return np.full((len(weights), 1), 1.0 / len(weights))
    # Points at the same distance from several corners are shared equally among them.
    nearest = np.isclose(weights, weights.max(axis=1, keepdims=True)).astype(np.float64)
    nearest /= nearest.sum(axis=1, keepdims=True)
    return np.asarray(nearest / nearest.sum(axis=0))


@dataclass(frozen=True, kw_only=True)
class Inclusion(Effect):
    """An ellipsoid along the axes whose modulus is `contrast` times that around it.

    `centre_mm`: centre, mm; `semi_axes_mm`: half-axes along x, y and z, mm.
    """

    id: ClassVar[str] = "inclusion"
    repeatable: ClassVar[bool] = True
    centre_mm: Vector = numbers("centre", 3)
    semi_axes_mm: Vector = numbers("half-axes along x, y and z", 3, above=0.0)
    contrast: float = number("modulus inside over outside", above=0.0)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with Young's modulus multiplied by `contrast` inside the ellipsoid."""
        return _stiffened(experiment, Ellipsoid(self.centre_mm, self.semi_axes_mm), self.contrast, element)


@dataclass(frozen=True, kw_only=True)
class Layer(Effect):
    """An outer layer below the free surface whose modulus is `contrast` times that of the core.

    `thickness_mm`: thickness of the layer, mm; held faces do not belong to the free surface.
    """

    id: ClassVar[str] = "layer"
    thickness_mm: float = number("depth below the free surface, which excludes held faces", above=0.0)
    contrast: float = number("modulus inside over outside", above=0.0)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with Young's modulus multiplied by `contrast` in the layer."""
        return _stiffened(experiment, OuterLayer(experiment.mesh, self.thickness_mm), self.contrast, element)


def _stiffened(experiment: Experiment, region: SharpRegion, contrast: float, element: Element) -> Experiment:
    factor = 1.0 + (contrast - 1.0) * share_inside(region, experiment.mesh, 4 if element == "tet10" else 1)
    return replace(experiment, material=experiment.material.scaled(factor))


def _lattice() -> FloatArray:
    """Return barycentric weights of points spread evenly through a tet, shape (n_points, 4)."""
    rows = range(_LATTICE_ROWS)
    steps = [(a, b, c) for a in rows for b in rows for c in rows if a + b + c < _LATTICE_ROWS]
    assert len(steps) == math.comb(_LATTICE_ROWS + 2, 3)
    inner = (np.array(steps, np.float64) + 0.25) / (_LATTICE_ROWS)
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
