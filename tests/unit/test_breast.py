"""Meshes of the breast phantom made by formula."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.errors import ArgumentError
from tissuereg.phantom.breast import BREAST, inside_breast
from tissuereg.phantom.stuffing import stuffed
from tissuereg.simulation.fine.bisection import shape_quality


def edges_of(triangles):
    return np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


@pytest.mark.parametrize("n_nodes", [150, 503, 1213, 4223])
def test_the_mesh_has_about_the_nodes_asked_for_and_fits_together(n_nodes):
    mesh = tr.phantom.breast_mesh(n_nodes)
    assert abs(mesh.n_nodes / n_nodes - 1.0) <= (0.02 if n_nodes >= 1000 else 0.04)
    faces = np.sort(mesh.tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    assert np.unique(faces, axis=0, return_counts=True)[1].max() == 2
    # The boundary is closed, so that no face of a tet ends in the middle of another one's.
    np.testing.assert_array_equal(np.unique(edges_of(mesh.surface), axis=0, return_counts=True)[1], 2)
    assert shape_quality(mesh.nodes, mesh.tets).min() > 0.2  # what the embedded meshes of another program have: 0.3


def test_the_boundary_lies_on_the_skin_or_on_the_chest_wall():
    mesh = tr.phantom.breast_mesh(2000)
    outer = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)]
    depth = np.abs(inside_breast(outer))
    # Nodes are rounded to 1e-4 mm; near the apex the skin lies flat in the sections in which depth is measured.
    assert depth[outer[:, 2] < 45.0].max() < 5e-4
    assert (mesh.nodes[mesh.fixed_nodes, 2] == 0.0).all()


def test_the_volume_tends_to_that_of_the_embedded_mesh():
    exact = tr.phantom.phantom_mesh().volumes.sum()
    coarse, fine = (tr.phantom.breast_mesh(n).volumes.sum() for n in (1000, 8000))
    # Flat triangles inside a convex skin lose volume with the square of their size: four times less at half the size.
    assert abs(coarse / exact - 1.0) < 0.02
    assert abs(fine / exact - 1.0) < 0.006


def test_the_embedded_mesh_lies_inside_the_same_skin():
    mesh = tr.phantom.phantom_mesh()
    outer = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)]
    # Its skin was a polyhedron of 40 rings by 120 points, whose sagitta is some 0.02 mm.
    assert np.abs(inside_breast(outer))[outer[:, 2] < 45.0].max() < 0.2


def test_a_ball_cut_in_half_has_the_volume_of_one():
    def inside(points):
        return 20.0 - np.linalg.norm(points, axis=1)

    volumes = []
    for size in (4.0, 2.0):
        nodes, tets = stuffed(inside, np.array([-21.0, -21.0, 0.0]), np.array([21.0, 21.0, 21.0]), size)
        volumes.append(tr.Mesh(nodes, tets).volumes.sum())
    lost = 2 / 3 * np.pi * 20.0**3 - np.array(volumes)
    assert (lost > 0.0).all()
    assert 3.0 < lost[0] / lost[1] < 5.5  # second order


def test_the_same_mesh_comes_again():
    from tissuereg.phantom.breast import _breast_mesh

    first = tr.phantom.breast_mesh(500).digest()
    _breast_mesh.cache_clear()
    assert tr.phantom.breast_mesh(500).digest() == first


@pytest.mark.parametrize("n_nodes", [0, 99, 10**6, 1000.0, "many", None, True])
def test_a_number_of_nodes_that_cannot_be_is_refused(n_nodes):
    with pytest.raises(ArgumentError, match="n_nodes"):
        tr.phantom.breast_mesh(n_nodes)


def test_the_radius_at_the_chest_wall_is_the_stated_one():
    mesh = tr.phantom.breast_mesh(1000)
    assert np.linalg.norm(mesh.nodes[mesh.fixed_nodes], axis=1).max() == pytest.approx(BREAST.radius_mm, abs=2e-4)
