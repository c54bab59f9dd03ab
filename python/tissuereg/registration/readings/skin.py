"""Distances of many points at once from the surface of a body, and from its held nodes."""

from threading import Lock
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.closest import closest_on_triangles
from tissuereg.body.mesh import Mesh, per_mesh
from tissuereg.registration.readings.settings import MOTION, PROPOSALS

#: Numbers that describe the closest place of a point.
_VALUES = 8

_KEEPING = Lock()


class Closest(NamedTuple):
    """Closest places on a surface to points of shape (..., 3); the arrays have the leading axes of the points.

    `distance` (...): mm, negative inside the body; `foot` (..., 3): closest point of the surface, mm; `normal` (...,
    3): outward unit normal of the triangle that contains the foot; `held` bool (...): whether all its corners are held.
    """

    distance: FloatArray
    foot: FloatArray
    normal: FloatArray
    held: BoolArray


class Skin:
    """The surface of a mesh, sampled once for nearest-triangle queries.

    `mesh`: undeformed body. `extent`: largest extent of the body along an axis, mm; `middle` (3,): middle of its
    bounding box, mm; `spread`: root mean square distance of the surface nodes from their mean, mm; `held` int64
    (n_held,): numbers of the held nodes; empty if the mesh has no set ``fixed``.
    """

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self.extent = mesh.extent
        self.middle: FloatArray = 0.5 * (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0))
        skin = mesh.nodes[mesh.surface_nodes]
        self.spread = float(np.sqrt(np.sum((skin - skin.mean(axis=0)) ** 2, axis=1).mean()))
        self._corners: FloatArray = mesh.nodes[mesh.surface]
        across = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        self._normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        shares = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0], [2.0, 2.0, 2.0]]) / 6.0
        self._samples = cKDTree(np.einsum("sc,tcx->tsx", shares, self._corners).reshape(-1, 3), balanced_tree=False)
        self._known: dict[bytes, FloatArray] = {}
        self.held: IntArray = mesh.node_sets.get("fixed", np.empty(0, np.int64))
        self._held_triangles: BoolArray = np.asarray(np.isin(mesh.surface, self.held).all(axis=1))
        self._held_tree = cKDTree(mesh.nodes[self.held], balanced_tree=False) if len(self.held) else None

    def closest(self, points: FloatArray) -> Closest:
        """Return the closest place on the surface, and the distance from it, of points (..., n, 3), mm.

        Points are taken in sets, (n, 3); the last sets are remembered, since reference places come again and again.
        """
        sets = points.reshape(-1, *points.shape[-2:])
        keys = [one.tobytes() for one in sets]
        with _KEEPING:
            found = {key: self._known[key] for key in keys if key in self._known}
        fresh = {key: number for number, key in enumerate(keys) if key not in found}
        if fresh:
            flat = self._closest(sets[list(fresh.values())].reshape(-1, 3)).reshape(len(fresh), -1, _VALUES)
            found |= dict(zip(fresh, flat, strict=True))
            with _KEEPING:
                self._known |= {key: found[key] for key in fresh}
                while len(self._known) > PROPOSALS.sets_kept:
                    self._known.pop(next(iter(self._known)))
        values = np.array([found[key] for key in keys]).reshape(*points.shape[:-1], _VALUES)
        return Closest(values[..., 0], values[..., 1:4], values[..., 4:7], values[..., 7] > 0.0)

    def _closest(self, flat: FloatArray) -> FloatArray:
        """Return for points (n, 3), mm, the columns distance, foot (3), normal (3) and held (1 or 0), as (n, 8)."""
        _, samples = self._samples.query(flat, k=PROPOSALS.closest)
        triangles = np.asarray(samples, np.int64) // 4
        corners = self._corners[triangles]
        feet = closest_on_triangles(flat[:, None], corners)
        off = flat[:, None] - feet
        gaps = np.einsum("pkx,pkx->pk", off, off)
        rows, best = np.arange(len(flat)), np.argmin(gaps, axis=1)
        normal = self._normals[triangles[rows, best]]
        inside = np.einsum("px,px->p", off[rows, best], normal) < 0.0
        distance = np.where(inside, -1.0, 1.0) * np.sqrt(gaps[rows, best])
        held = self._held_triangles[triangles[rows, best]]
        return np.column_stack([distance, feet[rows, best], normal, held])

    def freedom(self, points: FloatArray) -> FloatArray:
        """Return how freely the body can move at points: 0 at held nodes, towards 1 far from them.

        `points` (n, 3): mm. Result: (3, n), ``1 - exp(-d / l)`` with the distance d from the closest held node, l from
        0.08 (a layer that shears) to 0.7 extents (a beam that bends); 1 where nothing is held.
        """
        if self._held_tree is None:
            return np.ones((len(MOTION.fading), len(points)))
        distance = np.asarray(self._held_tree.query(points)[0]) / self.extent
        return np.asarray(np.maximum(-np.expm1(-distance / np.array(MOTION.fading)[:, None]), 0.02))


def skin_of(mesh: Mesh) -> Skin:
    """Return the surface of a mesh for nearest-triangle queries, cached while its set ``fixed`` stays the same."""
    found = _skin(mesh)
    held = mesh.node_sets.get("fixed")
    return found if (held is None and not len(found.held)) or found.held is held else Skin(mesh)


_skin = per_mesh(Skin)
