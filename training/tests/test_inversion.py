"""det F of the tetrahedra of a field."""

import numpy as np
import pytest
from conftest import make_block

from tissuereg_training.inversion import inversions, volume_ratios


@pytest.fixture(scope="module")
def block():
    return make_block(3, 3, 3)


def test_a_linear_map_has_its_determinant_in_every_tetrahedron(block):
    gradient = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.3], [-0.2, 0.0, 1.1]])
    field = (block.nodes @ (gradient - np.eye(3)).T).astype(np.float32)
    ratios = volume_ratios(block.nodes, block.tets, field[None])
    # Displacements in single precision.
    np.testing.assert_allclose(ratios, np.linalg.det(gradient), rtol=1e-5)


def test_a_mirrored_field_is_counted_and_a_still_one_is_not(block):
    still = np.zeros((2, block.n_nodes, 3), np.float32)
    mirrored = still[:1].copy()
    mirrored[..., 0] = -2.0 * block.nodes[:, 0]
    found = inversions(block.nodes, block.tets, [still, mirrored])
    assert found["fields"] == 3
    assert found["min_det_f"] == pytest.approx(-1.0)
    assert found["inverted_tets"] == pytest.approx(1 / 3)
    assert found["fields_with_inverted_tets"] == pytest.approx(1 / 3)


def test_one_node_pushed_through_its_neighbours_inverts_some_tetrahedra_alone(block):
    pushed = np.zeros((1, block.n_nodes, 3), np.float32)
    pushed[0, np.flatnonzero((block.nodes == 10.0).all(axis=1))] = (15.0, 0.0, 0.0)
    found = inversions(block.nodes, block.tets, [pushed])
    assert 0 < found["inverted_tets"] < 0.5
    assert found["fields_with_inverted_tets"] == 1.0
