"""How much of a body its flat facets leave out."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.diagnose.faceting import faceting


def ball(rings):
    """Return a ball of radius 30 as pyramids on triangles whose corners lie on its surface."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([[a, b * golden, 0.0] for a in (-1, 1) for b in (-1, 1)])
    nodes = np.concatenate([corners, np.roll(corners, 1, axis=1), np.roll(corners, 2, axis=1)])
    apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=2)
    near = apart < 2.01
    triples = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]
    ]
    faces = [nodes[list(t)] for t in triples]
    for _ in range(rings):
        halves = [(0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)) for a, b, c in faces]
        whole = zip(faces, halves, strict=True)
        faces = [np.array(t) for (a, b, c), (p, q, r) in whole for t in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]
        faces = [f / np.linalg.norm(f, axis=1)[:, None] for f in faces]
    places, index = np.unique(np.round(np.concatenate(faces), 9), axis=0, return_inverse=True)
    nodes = np.concatenate([30.0 * places / np.linalg.norm(places, axis=1)[:, None], np.zeros((1, 3))])
    tets = np.column_stack([index.reshape(-1, 3), np.full(len(faces), len(places))])
    a, b, c = (nodes[tets[:, k]] for k in range(3))
    turned = (np.cross(a, b) * c).sum(axis=1) > 0
    tets[turned] = tets[turned][:, [1, 0, 2, 3]]
    return tr.Mesh(nodes, tets)


@pytest.mark.parametrize("rings", [1, 2, 3])
def test_a_ball_of_facets_lacks_what_lies_between_them_and_the_sphere(rings):
    mesh = ball(rings)
    volume = mesh.volumes.sum()
    assert faceting(mesh) == pytest.approx((4.0 / 3.0 * np.pi * 30.0**3 - volume) / volume, rel=0.12)


def test_flat_sides_and_sharp_edges_leave_nothing_out():
    assert faceting(block((10.0, 20.0, 30.0), (2, 3, 4))) == 0.0
