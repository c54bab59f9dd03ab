"""The closest triangle of a surface is found exactly, however large the triangles and however far the points are."""

import numpy as np
import pytest
import trimesh

from support.surfaces import box, sphere, together
from tissuereg.body.closest import ClosestTriangles, barycentric, closest_on_triangles

#: Small triangles beside large and long ones.
MIXED = together(sphere(5.0), box((300.0, 2.0, 40.0), corner=(-150.0, 9.0, -20.0)))


@pytest.mark.parametrize(("surface", "spread"), [(sphere(), 15.0), (sphere(), 500.0), (MIXED, 20.0), (box(), 30.0)])
def test_no_triangle_is_closer_than_the_one_that_is_found(surface, spread):
    points = np.random.default_rng(0).normal(0.0, spread, (600, 3))
    corners = surface[0][surface[1]]
    found = ClosestTriangles(corners).find(points)
    feet = closest_on_triangles(points[:, None], corners)
    every = np.linalg.norm(points[:, None] - feet, axis=2)
    np.testing.assert_allclose(found.distances, every.min(axis=1), rtol=1e-12, atol=1e-12)
    own = every[np.arange(len(points)), found.triangles]
    np.testing.assert_allclose(own, found.distances, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points - found.feet, axis=1), found.distances, rtol=1e-12)


def test_distances_and_feet_are_those_of_trimesh():
    points = np.random.default_rng(1).normal(0.0, 20.0, (300, 3))
    for surface in (sphere(), box(), MIXED):
        feet, distances, triangles = trimesh.proximity.closest_point(trimesh.Trimesh(*surface, process=False), points)
        found = ClosestTriangles(surface[0][surface[1]]).find(points)
        np.testing.assert_allclose(found.distances, distances, atol=1e-6)
        apart = np.linalg.norm(found.feet - feet, axis=1) > 1e-3
        assert apart.mean() < 0.01  # of two faces as near as each other either may be taken
        inside = barycentric(found.feet, surface[0][surface[1][found.triangles]]).min(axis=1) > 1e-6
        assert np.array_equal(found.triangles[inside & ~apart], triangles[inside & ~apart])


def test_of_triangles_that_share_the_place_the_one_that_faces_the_point_is_taken_and_else_the_first():
    corners = np.array(
        [
            [[0.0, 0, 0], [9, 0, 0], [9, 9, 0]],  # level
            [[0.0, 0, 0], [9, 9, 0], [0, 9, 0]],  # level, the other half
            [[0.0, 0, 0], [0, 9, 0], [0, 0, -9]],  # a wall below its edge x = 0
        ]
    )
    search = ClosestTriangles(corners)
    assert search.find(np.array([[-1.0, 4, 3], [-3, 4, 1], [3, 3, 2], [3, 3, 0]])).triangles.tolist() == [1, 2, 0, 0]


def test_a_triangle_without_an_area_is_a_line_and_no_points_have_no_places():
    flat = np.array([[[0.0, 0, 0], [9, 0, 0], [4, 0, 0]]])
    assert closest_on_triangles(np.array([7.0, 2, 0]), flat[0]).tolist() == [7.0, 0.0, 0.0]
    search = ClosestTriangles(flat)
    assert search.find(np.array([[7.0, 2, 0]])).distances.tolist() == [2.0]
    assert [len(one) for one in search.find(np.empty((0, 3)))] == [0, 0, 0]


def test_weights_give_the_point_back():
    rng = np.random.default_rng(2)
    corners, weights = rng.normal(size=(50, 3, 3)), rng.dirichlet(np.ones(3), 50)
    np.testing.assert_allclose(barycentric(np.einsum("nc,ncx->nx", weights, corners), corners), weights, atol=1e-9)
