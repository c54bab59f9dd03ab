"""A half ellipsoid of any size, loaded on one patch: the problems of the size study, from numpy alone."""

from pathlib import Path

import numpy as np

RADIUS_MM, HEIGHT_MM = 60.0, 50.0
LOAD_MN, PATCH_MM = 2780.0, 20.0
SEED = 0


def half_ellipsoid(n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (n, 3) in mm and tets (m, 4) of a half ellipsoid with about this many nodes.

    A grid of cells on [-1, 1]^2 x [0, 1] is pulled onto the ball; each cell becomes twelve tets about its centre, its
    faces being cut into two triangles, alike from both sides. Centres are jittered by a tenth
    of a cell and nodes and tets numbered at random, so that no solver gains from an order that a mesher would not give.
    """
    width, depth = min(
        ((n, m) for n in range(2, 80) for m in {n // 2, (n + 1) // 2}),
        key=lambda size: abs((size[0] + 1) ** 2 * (size[1] + 1) + size[0] ** 2 * size[1] - n_nodes),
    )
    along, up = np.linspace(-1, 1, width + 1), np.linspace(0, 1, depth + 1)
    corners = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = np.abs(corners).max(axis=1, keepdims=True)
    corners *= reach / np.maximum(np.linalg.norm(corners, axis=1, keepdims=True), 1e-30)
    corners *= [RADIUS_MM, RADIUS_MM, HEIGHT_MM]
    number = np.arange(len(corners)).reshape(width + 1, width + 1, depth + 1)
    cells = np.stack(
        [number[i : i + width, j : j + width, k : k + depth].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)],
        axis=1,
    )
    rng = np.random.default_rng(SEED)
    jitter = 0.1 * np.cbrt(2 / 3 * np.pi * RADIUS_MM**2 * HEIGHT_MM / len(cells))
    centres = corners[cells].mean(axis=1) + jitter * rng.uniform(-0.5, 0.5, (len(cells), 3))

    def area(triangles: np.ndarray) -> np.ndarray:
        sides = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
        return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)

    tets = []
    for face in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
        ring = cells[:, face]
        # the cut whose smaller triangle is larger; where both are alike, that through the smallest number
        uncut, cut_off = (
            np.minimum(area(ring[:, [i, i + 1, i + 2]]), area(ring[:, [i, i + 2, i - 1]])) for i in (0, 1)
        )
        by_number = ring.argmin(axis=1) % 2
        first = np.where(np.isclose(uncut, cut_off, rtol=1e-9), by_number, cut_off > uncut).astype(int)[:, None]
        ring = np.take_along_axis(ring, (first + np.arange(4)) % 4, axis=1)
        centre = len(corners) + np.arange(len(cells))
        tets += [np.column_stack([ring[:, 0], ring[:, a], ring[:, a + 1], centre]) for a in (1, 2)]
    nodes, cut = np.concatenate([corners, centres]), np.concatenate(tets)
    edges = nodes[cut[:, 1:]] - nodes[cut[:, :1]]
    inverted = np.linalg.det(edges) < 0
    cut[inverted, :2] = cut[inverted, 1::-1]
    order = rng.permutation(len(nodes))
    renumbered = np.empty_like(order)
    renumbered[order] = np.arange(len(nodes))
    return nodes[order], renumbered[cut][rng.permutation(len(cut))]


def write_size(path: Path, n_nodes: int) -> None:
    """Write the problem of one size: base held, a patch near the top pulled outward, E 10 kPa, nu 0.45."""
    nodes, tets = half_ellipsoid(n_nodes)
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    outside = faces[count == 1]
    middle = nodes[outside].mean(axis=1)
    normal = np.array([0.6, 0.0, 0.8])
    centre = normal * [RADIUS_MM, RADIUS_MM, HEIGHT_MM]
    patch = outside[np.linalg.norm(middle - centre, axis=1) < PATCH_MM]
    sides = nodes[patch[:, 1:]] - nodes[patch[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    forces = np.zeros_like(nodes)
    np.add.at(forces, patch.ravel(), np.repeat(area / area.sum() / 3, 3)[:, None] * LOAD_MN * normal)
    fixed = np.flatnonzero(nodes[:, 2] < 1e-9)
    np.savez(path, nodes_mm=nodes, tets=tets, fixed_nodes=fixed, forces_mN=forces, young_kPa=10.0, poisson=0.45)
