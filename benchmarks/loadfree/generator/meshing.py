"""Meshes of the bodies: tetrahedra from surfaces (pytetwild) and from bricks."""

import json
import tempfile
from pathlib import Path

import numpy as np
import skfem

from blind.generator.shapes import boundary_triangles, tets_from_bricks, volumes

#: How far a mesher may leave a plane that the body ends in, mm.
SNAP_MM = 0.35


def box_surface(size):
    """Return corners (8, 3) and triangles (12, 3) of the box from (0, 0, 0) to `size`, normals outward."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * np.asarray(size, dtype=float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def box_bricks(size, counts, rng):
    """Return nodes (n, 3) and tets (m, 4) of a box cut into bricks of six tetrahedra each."""
    lines = [np.linspace(0.0, s, n + 1) for s, n in zip(size, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    a = np.arange(len(nodes)).reshape([n + 1 for n in counts])
    n, m, o = counts
    bricks = [a[i : n + i, j : m + j, k : o + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return nodes, tets_from_bricks(nodes, np.stack(bricks, axis=1), rng)


def ball_surface(axes, n=48):
    """Return points and triangles of the ellipsoid with half lengths `axes`, from rings of `n` points."""
    rise, turn = np.linspace(0, np.pi, n // 2 + 1)[1:-1], np.arange(n) * 2 * np.pi / n
    rings = [[np.sin(r) * np.cos(t), np.sin(r) * np.sin(t), np.cos(r)] for r in rise for t in turn]
    points = np.array([*rings, [0, 0, 1.0], [0, 0, -1.0]]) * np.asarray(axes)
    number = np.arange(len(rings)).reshape(len(rise), n)
    a, b = number[:-1], number[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    body = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([c, b, d], -1).reshape(-1, 3)])
    top, low = number[0], number[-1]
    caps = [np.stack([np.full(n, len(rings)), top, np.roll(top, -1)], -1)]
    caps += [np.stack([np.full(n, len(rings) + 1), np.roll(low, -1), low], -1)]
    return points, np.concatenate([body, *caps])


def tube_surface(start, end, radius, n=36):
    """Return points and triangles of a closed cylinder between two points."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, [1.0, 0.2, 0.1])
    side /= np.linalg.norm(side)
    turn = np.arange(n) * 2 * np.pi / n
    ring = radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(along, side))
    points = np.concatenate([start + ring, end + ring, [start, end]])
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    wall = [np.stack([a, b, a + n], -1), np.stack([b, b + n, a + n], -1)]
    caps = [np.stack([b, a, np.full(n, 2 * n)], -1), np.stack([a + n, b + n, np.full(n, 2 * n + 1)], -1)]
    return points, np.concatenate(wall + caps)


def difference(operations, edge_share):
    """Return nodes and tets of a body given by a tree of surfaces (constructive solid geometry).

    Parameters
    ----------
    operations : dict
        ``{"operation": "difference" | "intersection" | "union", "left": ..., "right": ...}`` whose leaves are pairs
        (points, triangles).
    edge_share : float
        Longest edge over the diagonal of the body.
    """
    import pytetwild

    with tempfile.TemporaryDirectory() as folder:
        names = []

        def written(tree):
            if isinstance(tree, dict):
                return tree | {side: written(tree[side]) for side in ("left", "right")}
            path = Path(folder) / f"{len(names)}.obj"
            names.append(path)
            points, triangles = tree
            rows = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
            rows += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
            path.write_text("\n".join(rows) + "\n", encoding="utf-8")
            return str(path)

        path = Path(folder) / "tree.json"
        path.write_text(json.dumps(written(operations)), encoding="utf-8")
        grid = pytetwild.tetrahedralize_csg(str(path), edge_length_r=edge_share, coarsen=False, num_threads=1)
    return np.asarray(grid.points, dtype=float), np.asarray(grid.cells_dict[10], dtype=int)


def filled(points, triangles, edge_mm):
    """Return nodes and tets that fill a closed surface."""
    import pytetwild

    nodes, tets = pytetwild.tetrahedralize(
        points, triangles.astype(np.int32), edge_length_abs=edge_mm, epsilon=5e-4, num_threads=1
    )
    return np.asarray(nodes, dtype=float), np.asarray(tets, dtype=int)


def tidy(nodes, tets, planes):
    """Return a mesh of used nodes and positive tets whose surface nodes near planes (axis, place) lie in them."""
    used, tets = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used].copy(), tets.reshape(-1, 4).copy()
    skin = np.unique(boundary_triangles(tets))
    for axis, place in planes:
        near = skin[np.abs(nodes[skin, axis] - place) < SNAP_MM]
        nodes[near, axis] = place
    turned = volumes(nodes, tets) < 0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    size = volumes(nodes, tets)
    if size.min() <= 1e-3 * np.median(size):
        message = f"a tetrahedron is flat: {size.min():.3g} of {np.median(size):.3g} mm^3"
        raise ValueError(message)
    return np.round(nodes, 5), tets


def refined_near(mesh, axis, spots, shape=None):
    """Return a skfem.MeshTet with bisected tetrahedra where surface edges near spots are too long.

    Parameters
    ----------
    mesh : skfem.MeshTet
    axis : int
        The base is where this coordinate is zero.
    spots : list of tuple
        Each (centre, radius, edge) in mm: surface within the radius gets edges of at most 1.35 `edge`.
    shape : blind.generator.shapes.Shape, optional
        The surface that new nodes are moved onto.
    """
    for _ in range(20):
        skin = skin_facets(mesh, axis)
        ends = mesh.p[:, mesh.facets[:, skin]]
        longest = np.max([np.linalg.norm(ends[:, i] - ends[:, i - 1], axis=0) for i in range(3)], axis=0)
        wanted = np.zeros(len(skin), dtype=bool)
        for centre, radius, edge in spots:
            centre = np.asarray(centre)
            distance = np.linalg.norm(ends - centre[:, None, None], axis=0).min(axis=0)
            middle = np.linalg.norm(ends.mean(axis=1) - centre[:, None], axis=0)
            wanted |= ((distance < radius) | (middle < radius)) & (longest > 1.35 * edge)
        if not wanted.any():
            return mesh
        mesh = mesh.refined(np.unique(mesh.f2t[0, skin[wanted]]))
        if shape is not None:
            nodes, p = np.unique(mesh.facets[:, skin_facets(mesh, axis)]), mesh.p.copy()
            p[:, nodes] = shape.on_surface(p[:, nodes].T).T
            mesh = skfem.MeshTet(p, mesh.t)
    return mesh


def curved(mesh, axis, shape):
    """Return the skfem.MeshTet2 whose nodes between corners lie on the surface too."""
    cells = skfem.CellBasis(mesh, skfem.ElementTetP2(), intorder=1)
    nodes = cells.get_dofs(skin_facets(mesh, axis)).flatten()
    places = cells.doflocs.copy()
    places[:, nodes] = shape.on_surface(places[:, nodes].T).T
    return skfem.MeshTet2(places, skfem.MeshTet2.from_mesh(mesh).t)


def skin_facets(mesh, axis):
    """Return the boundary facets off the base."""
    facets = mesh.boundary_facets()
    return facets[np.abs(mesh.p[axis][mesh.facets[:, facets]]).max(axis=0) > 1e-9]
