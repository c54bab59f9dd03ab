"""Fixtures. Helpers of the package's tests are imported by `support`, benches, twin and scripts by their names."""

import pytest

import tissuereg as tr
from support.meshes import block


@pytest.fixture(scope="session")
def block_mesh() -> tr.Mesh:
    """A block of 30 x 20 x 40 mm, 360 tets; the face z = 0 is the node set ``fixed``."""
    return block()
