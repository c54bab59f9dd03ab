"""Patches of contact: areas, sides, sizes, and how they lie to each other."""

import itertools

import numpy as np
import pytest

from support.meshes import block
from tissuereg.registration.contacts.patches import make_patches, surface_of_nodes
from tissuereg.registration.contacts.settings import DISCRETISATION

FACES = [(axis, side) for axis in range(3) for side in (0, 1)]


@pytest.fixture(scope="module")
def mesh():
    return block(cells=(9, 6, 12))


@pytest.fixture(scope="module")
def patches(mesh):
    return make_patches(mesh, np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes))


def lists(first, entries):
    return [entries[a:b] for a, b in itertools.pairwise(first)]


def test_a_uniform_pressure_adds_up_to_the_surface(mesh):
    areas, normals = surface_of_nodes(mesh)
    assert areas.sum() == pytest.approx(2 * (30 * 20 + 30 * 40 + 20 * 40))
    assert not areas[np.setdiff1d(np.arange(mesh.n_nodes), mesh.surface_nodes)].any()
    assert np.allclose(np.linalg.norm(normals[mesh.surface_nodes], axis=1), 1.0)
    outward = np.einsum("ij,ij->i", normals, mesh.nodes - mesh.nodes.mean(axis=0))
    assert (outward[mesh.surface_nodes] > 0).all()


def test_the_force_of_a_patch_is_the_integral_of_its_profile(mesh, patches):
    total = np.asarray(patches.shapes.sum(axis=1)).ravel()
    gaps = np.min([np.abs(patches.centres[:, a] - s * [30, 20, 40][a]) for a, s in FACES if (a, s) != (1, 1)], axis=0)
    inner = (patches.normals[:, 1] > 0.99) & (gaps >= patches.radii)
    assert inner.sum() > 3
    # pi r^2 / 2 over 1.6 r; lumped areas of a mesh of 3.3 mm under radii from 5 mm.
    assert total[inner] == pytest.approx(np.pi * patches.radii[inner] / 3.2, rel=0.12)


def test_shapes_are_areas_times_the_profile(mesh, patches):
    areas, normals = surface_of_nodes(mesh)
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    for patch in range(0, patches.n_patches, 7):
        distance = np.linalg.norm(mesh.nodes - patches.centres[patch], axis=1)
        wanted = areas * np.maximum(1 - (distance / patches.radii[patch]) ** 2, 0) / (1.6 * patches.radii[patch])
        wanted[normals @ patches.normals[patch] <= 0.1] = 0.0
        wanted[np.setdiff1d(np.arange(mesh.n_nodes), free)] = 0.0
        assert np.allclose(patches.shapes[[patch]].toarray()[0], wanted)


def test_the_other_side_of_a_sheet_is_not_in_a_patch():
    sheet = block((60.0, 60.0, 3.0), (10, 10, 1))
    found = make_patches(sheet, sheet.surface_nodes)
    top = np.flatnonzero(found.normals[:, 2] > 0.9)
    assert len(top) > 10
    assert not found.shapes[top][:, sheet.nodes[:, 2] == 0.0].toarray().any()
    first, entries, _ = found.texture
    inside = np.concatenate([entries[first[patch] : first[patch + 1]] for patch in top])
    assert len(inside) > 10
    assert (found.normals[inside, 2] > 0.0).all()
    # Both sides have patches of every radius, about as many: neither takes the other's place.
    count = [np.bincount(found.level[sign * found.normals[:, 2] > 0.5], minlength=3) for sign in (-1, 1)]
    assert (np.abs(count[0] - count[1]) <= 0.4 * count[0]).all()
    assert count[0].min() > 3


def test_radii_are_shares_of_the_body_but_not_below_its_mesh(mesh):
    corners = mesh.nodes[mesh.surface]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    fine = np.unique(make_patches(mesh, mesh.surface_nodes).radii)
    assert fine.min() >= 1.2 * edge * (1 - 1e-12)
    assert np.isin(np.round(fine[1:], 9), np.round(np.array(DISCRETISATION.radii_shares) * mesh.extent, 9)).all()
    coarse = block(cells=(2, 2, 2))
    assert make_patches(coarse, coarse.surface_nodes).radii.min() > 2 * fine.min()


def test_centres_of_one_radius_keep_their_distance_and_cover_the_surface(mesh, patches):
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    for level in np.unique(patches.level):
        own = patches.level == level
        radius = patches.radii[own][0]
        gaps = np.linalg.norm(patches.centres[own][:, None] - patches.centres[own][None], axis=2)
        same_side = patches.normals[own] @ patches.normals[own].T > 0.1
        assert gaps[same_side & ~np.eye(own.sum(), dtype=bool)].min(initial=np.inf) > 0.7 * radius
        reach = np.linalg.norm(mesh.nodes[free][:, None] - patches.centres[own][None], axis=2).min(axis=1)
        assert reach.max() <= 0.7 * radius


def test_held_nodes_belong_to_no_patch(mesh, patches):
    assert not patches.shapes[:, mesh.fixed_nodes].toarray().any()


def test_texture_is_the_next_smaller_radius_inside(patches):
    first, entries, ratios = patches.texture
    assert len(first) == patches.n_patches + 1
    assert first[-1] == len(entries) == len(ratios)
    for patch, inside in enumerate(lists(first, entries)):
        assert (patches.level[inside] == patches.level[patch] - 1).all()
        gaps = np.linalg.norm(patches.centres[inside] - patches.centres[patch], axis=1)
        assert (gaps < patches.radii[patch]).all()
        assert np.allclose(ratios[first[patch] : first[patch + 1]], 0.5 * patches.radii[inside] / patches.radii[patch])
    assert len(entries) > patches.n_patches


def test_neighbours_are_mutual_and_reach_other_radii(patches):
    around = lists(*patches.neighbours)
    assert all(patch not in near for patch, near in enumerate(around))
    assert all(patch in around[other] for patch, near in enumerate(around) for other in near)
    steps = np.concatenate([patches.level[near] - patches.level[patch] for patch, near in enumerate(around)])
    assert set(np.unique(steps)) == {-1, 0, 1}


def test_supports_that_move_have_the_profile_without_the_area(mesh):
    found = make_patches(mesh, mesh.fixed_nodes, by_area=False)
    largest = np.asarray(found.shapes.max(axis=1).todense()).ravel()
    assert largest == pytest.approx(1.0)
