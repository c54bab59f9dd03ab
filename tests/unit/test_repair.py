"""Fields that turn tetrahedra inside out."""

import numpy as np
import pytest

from support.meshes import block
from tissuereg.body.mesh import det_f
from tissuereg.registration.learned import repair
from tissuereg.registration.learned.repair import repaired


@pytest.fixture(scope="module")
def mesh():
    return block()


def smooth_field(mesh):
    """Return a bending of the block, without inverted tetrahedra."""
    x = mesh.nodes / mesh.extent
    return 0.1 * mesh.extent * np.column_stack([x[:, 2] ** 2, 0.3 * x[:, 2] * x[:, 0], -0.2 * x[:, 2]])


def test_a_field_without_inverted_tetrahedra_is_returned_as_it_is(mesh):
    field = smooth_field(mesh)
    found, ratios = repaired(mesh, field)
    assert found is field
    assert np.array_equal(ratios, det_f(mesh, field))


def test_a_node_that_was_pushed_through_its_neighbours_is_mended_and_the_rest_is_left(mesh):
    field = smooth_field(mesh)
    node = int(np.setdiff1d(np.arange(mesh.n_nodes), mesh.fixed_nodes)[-1])
    spoilt = field.copy()
    spoilt[node] -= 2.0 * mesh.extent
    assert det_f(mesh, spoilt).min() < 0
    found, ratios = repaired(mesh, spoilt)
    assert ratios.min() > 0
    assert np.array_equal(ratios, det_f(mesh, found))
    near = np.unique(mesh.tets[(mesh.tets == node).any(axis=1)])
    moved = np.flatnonzero((found != spoilt).any(axis=1))
    assert node in moved
    assert np.isin(moved, near).all()
    # The bending varies little from a node to its neighbours.
    assert np.linalg.norm(found[node] - field[node]) < 0.05 * mesh.extent


def test_held_nodes_stay_and_the_best_of_all_rounds_is_returned(mesh, monkeypatch):
    spoilt = smooth_field(mesh)
    free = np.setdiff1d(np.arange(mesh.n_nodes), mesh.fixed_nodes)
    # The free node can be mended, the held one cannot: smoothing about it goes on and makes things worse again.
    held, moved = mesh.fixed_nodes[1], free[len(free) // 2]
    spoilt[held] -= 1.5 * mesh.extent
    spoilt[moved] -= 2.0 * mesh.extent
    tried = []

    def recorded(mesh, field):
        tried.append((field, det_f(mesh, field)))
        return tried[-1][1]

    monkeypatch.setattr(repair, "det_f", recorded)
    found, ratios = repaired(mesh, spoilt)
    least = [each.min() for _, each in tried]
    best = int(np.argmax(least))
    assert 0 < best < len(tried) - 1
    assert least[0] < least[best]
    assert least[-1] < least[best] < 0
    assert np.array_equal(found, tried[best][0])
    assert np.array_equal(ratios, tried[best][1])
    assert np.array_equal(found[mesh.fixed_nodes], spoilt[mesh.fixed_nodes])
