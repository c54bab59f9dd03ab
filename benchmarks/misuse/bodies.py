"""The five bodies of the bench, each with the nodes that are held, in the frame that a user would have."""

import os
import tempfile
from pathlib import Path

import numpy as np

import tissuereg as tr
from support.meshes import block
from tissuereg.phantom import phantom_mesh

#: Half ellipsoid of the reference problems (radius 60 mm, height 50 mm, base held), next to the repository.
DOME = Path(__file__).resolve().parents[3] / "shared" / "reference" / "dome_4k_pull.npz"

#: The organ-like ellipsoid: half axes, middle and turn about x and z, as if in a scanner's frame.
HALF_AXES_MM, MIDDLE_MM, TURN_DEG = (58.0, 41.0, 33.0), (-84.0, 37.0, 152.0), (25.0, 40.0)
EDGE_MM = 9.0


def dome() -> tr.Mesh:
    with np.load(DOME) as kept:
        return tr.Mesh(kept["nodes_mm"], kept["tets"].astype(np.int64), {"fixed": kept["fixed_nodes"].astype(np.int64)})


def slab() -> tr.Mesh:
    """Return a slab of 90 x 60 x 18 mm, glued on its lower side, off the origin."""
    mesh = block((90.0, 60.0, 18.0), (15, 10, 4))
    return tr.Mesh(mesh.nodes + np.array([20.0, -35.0, 10.0]), mesh.tets, mesh.node_sets)


def beam() -> tr.Mesh:
    """Return a beam of 100 x 30 x 30 mm, held at x = -100, its tip at x = 0."""
    mesh = block((100.0, 30.0, 30.0), (16, 5, 5))
    nodes = mesh.nodes - np.array([100.0, 0.0, 0.0])
    return tr.Mesh(nodes, mesh.tets, {"fixed": np.flatnonzero(nodes[:, 0] < -99.9)})


def ellipsoid() -> tr.Mesh:
    """Return an ellipsoid with its own axes, held where its lowest eighth rests; meshed by fTetWild."""
    import pytetwild
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=3)
    tilt, turn = np.deg2rad(TURN_DEG)
    about_x = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    about_z = [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    points = (sphere.vertices * HALF_AXES_MM) @ (np.array(about_z) @ about_x).T + MIDDLE_MM
    started_in = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)  # the mesher leaves a file where it runs
        try:
            nodes, tets = pytetwild.tetrahedralize(
                np.ascontiguousarray(points),
                np.asarray(sphere.faces, np.int32),
                edge_length_fac=EDGE_MM / float(np.linalg.norm(np.ptp(points, axis=0))),
                quiet=True,
                num_threads=1,
            )[:2]
        finally:
            os.chdir(started_in)
    nodes, tets = np.asarray(nodes, np.float64), np.asarray(tets, np.int64)
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    skin = np.unique(tr.Mesh(nodes, tets).surface)
    low = nodes[skin, 2] < nodes[:, 2].min() + 0.125 * np.ptp(nodes[:, 2])
    return tr.Mesh(nodes, tets, {"fixed": skin[low]})


BODIES = {"dome": dome, "phantom": lambda: phantom_mesh("small"), "slab": slab, "beam": beam, "ellipsoid": ellipsoid}
