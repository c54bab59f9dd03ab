"""Make the meshes of the embedded breast phantom (needs the extra `mesh`), and the truth of its event.

    python tools/phantom_meshes.py            # meshes, then the truth on them
    python tools/phantom_meshes.py --truth    # the truth alone, on the meshes that are there

writes ``python/tissuereg/phantom/data/{full,small}-{body,truth}.npz``: for each size the mesh that users simulate on,
and the finer mesh on which the phantom's "measurement" is made, with its true displacement. They share the surface, no
inner node. The full body is that of ``breast_mesh``, kept so that it has the same digest on every machine; the
other program does not make the same mesh twice.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
import own_sources  # noqa: F401 (before the package)

from tissuereg.phantom import SIZES, breast_mesh
from tissuereg.phantom.event import solve_truth
from tissuereg.simulation.recipe import DEFAULT_NODES

DATA = Path(__file__).resolve().parent.parent / "python" / "tissuereg" / "phantom" / "data"
RADIUS, HEIGHT, DROOP = 60.0, 52.0, 7.0
EDGE_LENGTH_SHARE = {"small-body": 0.0605, "small-truth": 0.0475, "full-truth": 0.029}


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
    import pytetwild

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


def write(name: str, nodes: np.ndarray, tets: np.ndarray, **more: np.ndarray) -> None:
    """Write one mesh, and what goes with it."""
    fixed = np.flatnonzero(nodes[:, 2] == 0.0)
    np.savez_compressed(
        DATA / f"{name}.npz",
        nodes_mm=nodes,
        tets=tets.astype(np.int32),
        fixed_nodes=fixed.astype(np.int32),
        **more,
    )
    print(f"{name}: {len(nodes)} nodes, {len(tets)} tets, {len(fixed)} held")


def main() -> None:
    """Write the meshes and the truths."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--truth", action="store_true", help="solve for the truth on the meshes that are there")
    if not parser.parse_args().truth:
        body = breast_mesh(DEFAULT_NODES)
        write("full-body", body.nodes, body.tets)
        surface = breast_surface()
        for name, share in EDGE_LENGTH_SHARE.items():
            write(name, *tetrahedra(*surface, share))
    for size in SIZES:
        with np.load(DATA / f"{size}-truth.npz") as mesh:
            nodes, tets = mesh["nodes_mm"], mesh["tets"]
        fields = (field.astype(np.float32) for field in solve_truth(size))
        write(f"{size}-truth", nodes, tets, **dict(zip(("displacement_mm", "on_body_mm"), fields, strict=True)))


if __name__ == "__main__":
    main()
