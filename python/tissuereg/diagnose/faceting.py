"""How much of a body a mesh of flat facets leaves out."""

import numpy as np

from tissuereg.mesh import Mesh

#: Facets that meet at more than this, in degrees, meet at an edge of the body itself.
SHARP = 45.0


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
    nodes, facets = mesh.nodes, mesh.surface
    normals = np.cross(nodes[facets[:, 1]] - nodes[facets[:, 0]], nodes[facets[:, 2]] - nodes[facets[:, 0]])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    normals = normals / (2.0 * areas[:, None])
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    owners = np.tile(np.arange(len(facets)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owners = edges[order], owners[order]
    paired = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    first, second = owners[paired], owners[paired + 1]
    lengths = np.linalg.norm(nodes[edges[paired, 1]] - nodes[edges[paired, 0]], axis=1)
    angles = np.arccos(np.clip((normals[first] * normals[second]).sum(axis=1), -1.0, 1.0))
    both = areas[first] + areas[second]
    # Every facet has three edges; each tells of a third of it.
    gaps = np.where(angles < np.radians(SHARP), both / lengths * angles / 4.0, 0.0)
    return float((gaps * both).sum() / 3.0 / mesh.volumes.sum())
