"""The data's mesh: curved ten-node tetrahedra, refined under the pads; and where points sit in it."""

from dataclasses import dataclass

import numpy as np
import skfem
from scipy.spatial import KDTree

from blind.generator.shapes import Shape, half_ball, tets_from_bricks


@dataclass(frozen=True)
class Grid:
    """Numbers of the O-grid, its turn, the longest edges under a pad and at its rim (mm), and the seed of the cuts."""

    across: int = 6
    up: int = 3
    shells: int = 3
    turn: float = 0.4
    pad_edge: float = 7.0
    rim_edge: float = 2.5
    seed: int = 0


def data_mesh(shape: Shape, grid: Grid, spots):
    """Return a skfem.MeshTet2 of a body.

    Parameters
    ----------
    shape : Shape
    grid : Grid
    spots : list of tuple
        Each (centre, radius): surface within the radius gets edges of at most ``grid.pad_edge``.
    """
    corners, bricks = half_ball(grid.across, grid.up, grid.shells, grid.turn)
    tets = tets_from_bricks(corners, bricks, np.random.default_rng(grid.seed))
    mesh = refined(shape, shape.in_body(corners), tets, spots, grid.pad_edge, grid.rim_edge)
    cells = skfem.CellBasis(mesh, skfem.ElementTetP2(), intorder=1)
    nodes = cells.get_dofs(_skin(mesh)).flatten()
    places = cells.doflocs.copy()
    places[:, nodes] = shape.on_surface(places[:, nodes].T).T
    curved = skfem.MeshTet2.from_mesh(mesh)
    return skfem.MeshTet2(places, curved.t), places


def refined(shape, nodes, tets, spots, pad_edge, rim_edge):
    """Return a skfem.MeshTet with bisected tetrahedra where surface edges at pads or their rims are too long (mm)."""
    mesh = skfem.MeshTet(nodes.T.copy(), tets.T.copy())
    for _ in range(20):
        skin = _skin(mesh)
        ends = mesh.p[:, mesh.facets[:, skin]]
        longest = np.max([np.linalg.norm(ends[:, i] - ends[:, i - 1], axis=0) for i in range(3)], axis=0)
        pad = np.zeros(len(skin), dtype=bool)
        rim = pad.copy()
        for centre, radius in spots:
            distance = np.linalg.norm(ends - centre[:, None, None], axis=0)
            rim |= (distance.min(axis=0) < radius) & (distance.max(axis=0) > radius)
            middle = np.linalg.norm(ends.mean(axis=1) - centre[:, None], axis=0)
            pad |= (distance.min(axis=0) < radius) | (middle < radius)
        wanted = skin[(pad & (longest > 1.35 * pad_edge)) | (rim & (longest > 1.35 * rim_edge))]
        if not len(wanted):
            break
        mesh = mesh.refined(np.unique(mesh.f2t[0, wanted]))
        nodes = np.unique(mesh.facets[:, _skin(mesh)])
        p = mesh.p.copy()
        p[:, nodes] = shape.on_surface(p[:, nodes].T).T
        mesh = skfem.MeshTet(p, mesh.t)
    return mesh


def _skin(mesh):
    """Return the boundary facets off the base."""
    facets = mesh.boundary_facets()
    return facets[mesh.p[2][mesh.facets[:, facets]].max(axis=0) > 1e-9]


def shape_functions(x):
    """Return the ten shape functions (10, n) of a tetrahedron and their gradients (10, 3, n), in skfem's order."""
    element = skfem.ElementTetP2()
    both = [element.lbasis(x, i) for i in range(10)]
    return np.stack([v for v, _ in both]), np.stack([g for _, g in both])


class Place:
    """A point of the body: an element and weights of its ten nodes."""

    def __init__(self, nodes, weights):
        self.nodes, self.weights = nodes, weights


def find_places(places, element_dofs, points, on_skin=None):
    """Return nodes (n, 10) and weights (n, 10) that interpolate at points.

    Parameters
    ----------
    places : ndarray (3, n_dofs)
        Node places.
    element_dofs : ndarray (10, n_elements)
    points : ndarray (n, 3)
    on_skin : ndarray (k, 2), optional
        Element and its corner opposite to the skin facet: points are then projected onto these facets.
    """
    allowed = np.arange(element_dofs.shape[1]) if on_skin is None else on_skin[:, 0]
    corners = places[:, element_dofs[:4]][:, :, allowed]
    if on_skin is None:
        middle = corners.mean(axis=1).T
    else:
        middle = (corners.sum(axis=1) - corners[:, on_skin[:, 1], np.arange(len(allowed))]).T / 3
    tree = KDTree(middle)
    nodes, weights = np.empty((len(points), 10), dtype=int), np.empty((len(points), 10))
    for i, point in enumerate(points):
        best = None
        for candidate in tree.query(point, k=30)[1]:
            element = allowed[candidate]
            dofs = element_dofs[:, element]
            local, miss = _local(places[:, dofs], point, None if on_skin is None else on_skin[candidate, 1])
            share = np.array([1 - local.sum(), *local])
            score = max(0.0, -share.min()) * 10 + miss
            if best is None or score < best[0]:
                best = (score, dofs, local)
            if score < 1e-9:
                break
        if best[0] > 0.1:
            message = f"a point must lie in the body; {point} is off by {best[0]:.3g}"
            raise ValueError(message)
        nodes[i], weights[i] = best[1], shape_functions(best[2][:, None])[0][:, 0]
    return nodes, weights


def _local(nodes, point, opposite):
    """Return local coordinates of a point in one element, kept on a facet if asked, and how far away its image is."""
    if opposite is None:
        origin, axes = np.zeros(3), np.eye(3)
    else:
        reference = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
        ends = np.delete(reference, opposite, axis=0)
        origin, axes = ends[0], (ends[1:] - ends[0]).T
    s = np.full(axes.shape[1], 1 / 3 if opposite is not None else 0.25)
    for _ in range(12):
        value, slope = shape_functions((origin + axes @ s)[:, None])
        off = point - nodes @ value[:, 0]
        step = np.linalg.lstsq(nodes @ slope[:, :, 0] @ axes, off, rcond=None)[0]
        s = s + np.clip(step, -0.5, 0.5)
        if np.abs(step).max() < 1e-12:
            break
    value, _ = shape_functions((origin + axes @ s)[:, None])
    return origin + axes @ s, np.linalg.norm(point - nodes @ value[:, 0])
