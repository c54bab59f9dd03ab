"""A triangle surface as written by segmentation programs and scanners, before it is filled with tetrahedra."""

from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray, IntArray, float_array, frozen, index_array
from tissuereg._base.choices import FRAMES, Frame
from tissuereg.errors import MeshError


class Triangles:
    """A surface of triangles, which may have defects such as holes, duplicates or inconsistent winding.

    Parameters
    ----------
    vertices : array_like of float, shape (n_vertices, 3)
        Coordinates of the vertices in mm.
    triangles : array_like of int, shape (n_triangles, 3)
        Vertex indices of each triangle, counter-clockwise seen from outside if the surface has no defects.
    frame : {"LPS", "RAS"}, optional
        Declared patient frame of the coordinates. Nothing is computed from it.

    Raises
    ------
    ShapeError
        If an array has another shape or dtype.
    MeshError
        If a coordinate is not finite, an index is out of range, there is no triangle, or `frame` is none of the two.

    Examples
    --------
    >>> corner = Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> corner
    Triangles(4 vertices, 4 triangles)
    >>> round(corner.volume, 3)
    121.5
    """

    def __init__(self, vertices: Any, triangles: Any, frame: Frame | None = None) -> None:
        if frame is not None:
            check_choice("frame", frame, FRAMES, MeshError)
        points = float_array("vertices", vertices, (None, 3))
        corners = index_array("triangles", triangles, (None, 3))
        if not len(corners):
            message = "a surface must have at least one triangle, got none"
            raise MeshError(message, where="triangles")
        if corners.min() < 0 or corners.max() >= len(points):
            bad = corners.min() if corners.min() < 0 else corners.max()
            message = f"triangles must name vertices 0 to {len(points) - 1}, got {bad}"
            raise MeshError(message, where="triangles")
        if not np.isfinite(points).all():
            row = int(np.argmin(np.isfinite(points).all(axis=1)))
            message = f"vertices must be finite, got {points[row].tolist()} in row {row}"
            raise MeshError(message, where="vertices")
        self.vertices: FloatArray = frozen(points.copy() if points is vertices else points)
        self.triangles: IntArray = frozen(corners.copy() if corners is triangles else corners)
        self.frame = frame

    def __repr__(self) -> str:
        return f"Triangles({len(self.vertices)} vertices, {len(self.triangles)} triangles)"

    @property
    def extent(self) -> float:
        """Largest extent, along a coordinate axis, of the vertices that triangles use, in mm."""
        return float(np.max(np.ptp(self.vertices[np.unique(self.triangles)], axis=0)))

    @property
    def corners(self) -> FloatArray:
        """Coordinates in mm of the three corners of every triangle, shape (n_triangles, 3, 3)."""
        return np.asarray(self.vertices[self.triangles])

    @property
    def areas(self) -> FloatArray:
        """Area of every triangle in mm^2, shape (n_triangles,)."""
        return triangle_areas(self.corners)

    @property
    def volume(self) -> float:
        """Volume that the surface encloses if it is closed, in mm^3; negative where its normals point inwards."""
        return float(signed_volumes(self.corners - self.vertices[self.triangles[0, 0]]).sum())


def triangle_areas(corners: FloatArray) -> FloatArray:
    """Return the areas (...) in mm^2 of triangles from the coordinates of their corners (..., 3, 3) in mm."""
    across = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return np.asarray(0.5 * np.linalg.norm(across, axis=-1))


def signed_volumes(corners: FloatArray) -> FloatArray:
    """Return the signed volumes (...), mm^3, of tets from the origin to triangles with corners (..., 3, 3), mm."""
    across = np.cross(corners[..., 0, :], corners[..., 1, :])
    return np.asarray(np.einsum("...i,...i->...", across, corners[..., 2, :]) / 6.0)
