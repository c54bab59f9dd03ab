"""Random events on a body."""

import numpy as np

from tissuereg.simulate.sampling import Event
from tissuereg.simulate.solve import Simulator


def test_tractions_of_patches_that_share_triangles_add_up(block_mesh):
    simulator = Simulator(block_mesh)
    top = np.ascontiguousarray(block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 39.9).all(axis=1)])
    pull, shear = np.array([0.0, 0.0, 0.2]), np.array([0.1, 0.0, 0.0])
    event = Event(((top, pull), (np.roll(top[: len(top) // 2], 1, axis=1), shear)), np.zeros(3))
    expected = sum(
        simulator.body.traction_forces(facets, np.tile(3.0 * traction, (len(facets), 1)))
        for facets, traction in event.patches
    )
    np.testing.assert_allclose(simulator.forces(event.load(simulator, 3.0)), expected, atol=1e-12)
