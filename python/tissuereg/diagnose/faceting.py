"""How much of a body a mesh of flat facets leaves out."""

import numpy as np

from tissuereg.mesh import Mesh
from tissuereg.simulate.fine.folds import folds_of


def faceting(mesh: Mesh) -> float:
    """Return the share of a body's volume that lies between its facets and a smooth surface through its nodes.

    Two facets of height h that meet at a small angle t lie h t / 4 below, or above, a smooth surface through their
    corners, on the mean over their area (equilateral triangles on a sphere, to first order).

    Parameters
    ----------
    mesh : Mesh
        Its nodes are taken to lie on the surface of the body.

    Returns
    -------
    float
        Below and above alike count as positive.
    """
    folds = folds_of(mesh.nodes, mesh.surface)
    ends = mesh.nodes[folds.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    both = folds.areas[folds.facets].sum(axis=1)
    # Every facet has three edges; each tells of a third of it.
    gaps = np.where(folds.is_sharp, 0.0, both / lengths * np.arccos(folds.cosines) / 4.0)
    return float((gaps * both).sum() / 3.0 / mesh.volumes.sum())
