"""Places on and in a body of tetrahedra, and how a field of the data's body is read there."""

import numpy as np
import scipy.sparse as sp
from scipy.spatial import KDTree

from blind.generator.mesh import shape_functions
from blind.generator.shapes import volumes

#: Elements near a point that are tried, and how far from it they are sought, mm.
N_CANDIDATES, REACH_MM = 10, 3.0


def surface_places(nodes, triangles, base, gap, count, rng):
    """Return points (count, 3) inside triangles, spread out, at least `gap` mm from the base's nodes."""
    corners = nodes[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(triangles), size=25 * count, p=area / area.sum())
    shares = 0.1 + 0.7 * rng.dirichlet(np.ones(3), size=len(chosen))
    points = np.einsum("ki,kix->kx", shares, corners[chosen])
    points = points[KDTree(base).query(points)[0] > gap]
    return np.round(spread(points, count, rng), 4)


def spread(points, count, rng):
    """Return points of a cloud, each the farthest of twenty draws from those before it."""
    found = [points[rng.integers(len(points))]]
    while len(found) < count:
        drawn = points[rng.integers(len(points), size=20)]
        found.append(drawn[KDTree(np.array(found)).query(drawn)[0].argmax()])
    return np.array(found)


def inner_places(nodes, tets, count, rng):
    """Return points (count, 3) spread evenly over the volume at random, inside tetrahedra."""
    chosen = rng.choice(len(tets), size=count, p=volumes(nodes, tets) / volumes(nodes, tets).sum())
    shares = 0.05 + 0.8 * rng.dirichlet(np.ones(4), size=count)
    return np.round(np.einsum("ki,kix->kx", shares, nodes[tets[chosen]]), 4)


def interpolation(body, points):
    """Return the matrix (n, n_nodes) that reads a field at points, and how far from the body they lie (n,), mm.

    The two meshes of a body differ by their facets: a point outside is moved to the body's nearest place.
    """
    near = _elements_near(body.places[:, body.dofs[:, :4]].transpose(1, 2, 0), points)
    nodes = body.places[:, body.dofs[near]].transpose(1, 2, 0, 3)  # (n, c, 3, 10)
    local = np.full((*near.shape, 3), 0.25)
    for _ in range(6):
        value, slope = _functions(local)
        off = points[:, None] - np.einsum("ncxa,nca->ncx", nodes, value)
        step = np.linalg.solve(np.einsum("ncxa,ncad->ncxd", nodes, slope), off[..., None])[..., 0]
        local = local + np.clip(step, -1.0, 1.0)
    shares = _inside(np.concatenate([1 - local.sum(axis=-1, keepdims=True), local], axis=-1))
    value, _ = _functions(shares[..., 1:])
    miss = np.linalg.norm(np.einsum("ncxa,nca->ncx", nodes, value) - points[:, None], axis=-1)
    row, best = np.arange(len(points)), miss.argmin(axis=1)
    rows, columns = np.repeat(row, 10), body.dofs[near[row, best]].ravel()
    matrix = sp.csr_matrix((value[row, best].ravel(), (rows, columns)), shape=(len(points), body.n_nodes))
    return matrix, miss[row, best]


def _elements_near(corners, points):
    """Return elements (n, N_CANDIDATES) of corners (m, 4, 3) that hold the points or come nearest."""
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    found = np.empty((len(points), N_CANDIDATES), dtype=int)
    order = KDTree(points, leafsize=60).indices  # neighbours come together
    for first in range(0, len(points), 60):
        part = order[first : first + 60]
        low, high = points[part].min(axis=0) - REACH_MM, points[part].max(axis=0) + REACH_MM
        kept = np.flatnonzero((corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1))
        local = np.einsum("mij,nmj->nmi", inverse[kept], points[part, None] - corners[kept, 0])
        shares = _inside(np.concatenate([1 - local.sum(axis=-1, keepdims=True), local], axis=-1))
        image = np.einsum("nma,max->nmx", shares, corners[kept])
        off = np.linalg.norm(image - points[part, None], axis=-1)
        found[part] = kept[np.argpartition(off, N_CANDIDATES, axis=1)[:, :N_CANDIDATES]]
    return found


def _inside(shares):
    """Return barycentric shares (..., 4) moved into the tetrahedron."""
    kept = np.clip(shares, 0.0, None)
    return kept / kept.sum(axis=-1, keepdims=True)


def _functions(local):
    """Return shape functions (..., 10) and gradients (..., 10, 3) at local coordinates (..., 3)."""
    value, slope = shape_functions(local.reshape(-1, 3).T)
    shape = local.shape[:-1]
    return value.T.reshape(*shape, 10), slope.transpose(2, 0, 1).reshape(*shape, 10, 3)
