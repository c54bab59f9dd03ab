"""Make the two meshes of the embedded breast phantom (needs the extra `mesh`).

    python tools/phantom_meshes.py

writes ``python/tissuereg/phantom/data/{body,truth}.npz``: the mesh that users simulate on, and the finer
mesh on which the phantom's "measurement" is made. They share the surface, no inner node.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
import pytetwild

DATA = Path(__file__).resolve().parent.parent / "python" / "tissuereg" / "phantom" / "data"
RADIUS, HEIGHT, DROOP = 60.0, 52.0, 7.0
EDGE_LENGTH_SHARE = {"body": 0.0605, "truth": 0.0475}


def dome_point(ring: float, angle: float) -> np.ndarray:
    """Return a point of the skin: `ring` runs from 0 at the chest wall to 1 at the apex, `angle` around."""
    elevation = ring * np.pi / 2
    z = HEIGHT * np.sin(elevation)
    fuller_below = 1 + 0.06 * np.sin(2 * elevation) * (1 - np.sin(angle)) / 2
    r = RADIUS * np.cos(elevation) * fuller_below
    return np.array([r * np.cos(angle), r * np.sin(angle) - DROOP * (z / HEIGHT) ** 2, z])


def breast_surface(n_rings: int = 40, n_around: int = 120, n_base: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) in mm and outward triangles (m, 3) of the closed skin and chest wall."""
    angles = 2 * np.pi * np.arange(n_around) / n_around
    skin = [[dome_point(i / n_rings, a) for a in angles] for i in range(n_rings)]
    base = [[p * [1 - k / n_base, 1 - k / n_base, 0] for p in skin[0]] for k in range(1, n_base)]
    points = np.array([p for ring in skin + base for p in ring] + [dome_point(1.0, 0.0), np.zeros(3)])
    rings = np.arange(len(points) - 2).reshape(-1, n_around)
    skin_rings, base_rings = rings[:n_rings], np.vstack([rings[:1], rings[n_rings:]])
    following = lambda ring: np.roll(ring, -1)  # noqa: E731
    triangles = []
    for below, above in itertools.pairwise(skin_rings):
        triangles += [np.c_[below, following(below), following(above)], np.c_[below, following(above), above]]
    for outer, inner in itertools.pairwise(base_rings):
        triangles += [np.c_[following(outer), outer, inner], np.c_[following(outer), inner, following(inner)]]
    apex, centre = np.full(n_around, len(points) - 2), np.full(n_around, len(points) - 1)
    triangles += [np.c_[skin_rings[-1], following(skin_rings[-1]), apex]]
    triangles += [np.c_[following(base_rings[-1]), base_rings[-1], centre]]
    return points, np.vstack(triangles).astype(np.int32)


def tetrahedra(points: np.ndarray, triangles: np.ndarray, edge_length_share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes rounded to 1e-4 mm and positive tets of the body inside a surface."""
    nodes, tets = pytetwild.tetrahedralize(
        points, triangles, edge_length_fac=edge_length_share, epsilon=2e-3, quiet=True
    )[:2]
    nodes = np.round(np.asarray(nodes, dtype=np.float64), 4)
    nodes[np.abs(nodes[:, 2]) < 0.05, 2] = 0.0
    tets = np.asarray(tets, dtype=np.int64)
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    negative = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return nodes, tets


def main() -> None:
    """Write both meshes."""
    formatter = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=__doc__, formatter_class=formatter).parse_args()
    surface = breast_surface()
    for name, share in EDGE_LENGTH_SHARE.items():
        nodes, tets = tetrahedra(*surface, share)
        fixed = np.flatnonzero(nodes[:, 2] == 0.0)
        np.savez_compressed(
            DATA / f"{name}.npz",
            nodes_mm=nodes,
            tets=tets.astype(np.int32),
            fixed_nodes=fixed.astype(np.int32),
        )
        print(f"{name}: {len(nodes)} nodes, {len(tets)} tets, {len(fixed)} held")


if __name__ == "__main__":
    main()
