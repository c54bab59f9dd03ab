"""What both solvers know of a rig's mesh: numbered functions, patches, and how to read places from a solution."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from rigs.generator.meshing import EDGES


@dataclass
class Skeleton:
    """Ten functions a tetrahedron: those of its corners, then of its edges.

    `places` (n, 3): coefficients of the position; `tets` (m, 10): functions; `faces` (k, 6): functions of outer
    triangles, corners first, then the edges between 0 1, 0 2, 1 2; `bulge`: value of an edge's function at its middle
    over a quarter, and `nodal`: whether corners' functions vanish there.
    """

    places: np.ndarray
    tets: np.ndarray
    faces: np.ndarray
    bulge: float
    nodal: bool

    def shape(self, weights, pairs):
        """Return the values (q, k) of functions at barycentric weights (q, 3 or 4)."""
        corners = weights * (2 * weights - 1) if self.nodal else weights
        edges = np.stack([weights[:, i] * weights[:, j] for i, j in pairs], axis=1) * self.bulge
        return np.concatenate([corners, edges], axis=1)

    @property
    def face_middles(self):
        """Middles (k, 3) of the outer triangles on the curved surface."""
        return self.on_faces(np.arange(len(self.faces)), np.full((len(self.faces), 3), 1 / 3)) @ self.places

    def on_faces(self, which, weights):
        """Return the matrix (q, n) that reads values at weights (q, 3) on outer triangles."""
        return self._matrix(self.faces[which], self.shape(weights, [(0, 1), (0, 2), (1, 2)]))

    def in_tets(self, which, weights):
        """Return the matrix (q, n) that reads values at weights (q, 4) in tetrahedra."""
        return self._matrix(self.tets[which], self.shape(weights, EDGES))

    def _matrix(self, functions, values):
        rows = np.repeat(np.arange(len(functions)), functions.shape[1])
        shape = (len(functions), len(self.places))
        return csr_matrix((values.ravel(), (rows, functions.ravel())), shape=shape)

    def patch(self, inside):
        """Return which functions belong to outer triangles inside a patch."""
        found = np.zeros(len(self.places), dtype=bool)
        found[self.faces[inside(self.face_middles)]] = True
        return found

    def corners(self):
        """Return which functions are those of corners."""
        found = np.zeros(len(self.places), dtype=bool)
        found[self.tets[:, :4]] = True
        return found

    def depth(self, rig):
        """Return the function that gives the distance of points (n, 3) from the skin that is not held."""
        middles = self.face_middles
        free = ~np.any([hold.inside(middles) for hold in rig.holds], axis=0)
        which = np.flatnonzero(free)
        grid = [(a, b, 1 - a - b) for a in (0.05, 0.35, 0.65, 0.95) for b in (0.05, 0.35, 0.65) if a + b <= 1]
        points = [self.on_faces(which, np.tile(w, (len(which), 1))) @ self.places for w in grid]
        tree = cKDTree(np.concatenate(points))
        return lambda at: tree.query(at.reshape(-1, 3))[0].reshape(at.shape[:-1])


def marked(skeleton, rig, n_places=40):
    """Return matrices that read markers on the free skin, spread over it, and targets inside."""
    rng = rig.rng(11)
    middles = skeleton.face_middles
    corners = skeleton.places[skeleton.faces[:, :3]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    free = ~np.any([p.inside(middles, grown=2.0) for p in rig.pads] + [h.inside(middles) for h in rig.holds], axis=0)
    # The ground hides what lies on it.
    free &= np.abs(middles[:, 2]) > 2.0
    which = rng.choice(np.flatnonzero(free), size=400, p=area[free] / area[free].sum())
    weights = rng.dirichlet(np.ones(3), size=400)
    reading = skeleton.on_faces(which, weights)
    points = reading @ skeleton.places
    off = ~np.any([p.inside(points, grown=1.5) for p in rig.pads], axis=0)
    candidates = np.flatnonzero(off)
    chosen = [int(rng.choice(candidates))]
    while len(chosen) < n_places:
        gaps = np.min(np.linalg.norm(points[candidates, None] - points[chosen], axis=2), axis=1)
        # Not the very farthest: places drawn, and kept apart.
        some = rng.choice(len(candidates), size=12, replace=False)
        chosen.append(int(candidates[some[np.argmax(gaps[some])]]))
    inner = skeleton.places[skeleton.tets[:, :4]].mean(axis=1)
    depth = skeleton.depth(rig)(inner)
    deep = np.flatnonzero(depth > 0.5 * depth.max())
    return reading[chosen], skeleton.in_tets(rng.choice(deep, size=2, replace=False), np.full((2, 4), 0.25))
