"""Meshes that tests share."""

import itertools

import numpy as np

import tissuereg as tr


def block(size=(30.0, 20.0, 40.0), cells=(4, 3, 5)) -> tr.Mesh:
    """Return a block cut into cubes of six tets (Kuhn); nodes at z = 0 are the set ``fixed``."""
    axes = [np.linspace(0.0, length, n + 1) for length, n in zip(size, cells, strict=True)]
    nodes, tets = kuhn(axes)
    return tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(nodes[:, 2] == 0.0)})


def kuhn(axes):
    """Return nodes (n, 3) and tets (m, 4) of a grid with planes at three axes, cubes of six tets."""
    cells = [len(axis) - 1 for axis in axes]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape([n + 1 for n in cells])
    tets = []
    for corner in itertools.product(*(range(n) for n in cells)):
        for order in itertools.permutations(range(3)):
            path = [np.array(corner)]
            for axis in order:
                path.append(path[-1] + np.eye(3, dtype=int)[axis])
            tet = [number[tuple(p)] for p in path]
            even = np.linalg.det(np.eye(3)[list(order)]) > 0
            tets.append(tet if even else [tet[0], tet[2], tet[1], tet[3]])
    return nodes, np.array(tets)
