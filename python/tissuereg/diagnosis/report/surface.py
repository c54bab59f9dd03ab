"""The body's surface for the view: a limited number of triangles, each with the patch it belongs to."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.experiment.experiment import Experiment

#: Number of triangles, at most; larger surfaces are coarsened.
MOST_TRIANGLES = 12_000


@dataclass(frozen=True, eq=False)
class PatchedSurface:
    """Triangles with their patches.

    Attributes
    ----------
    nodes : ndarray of float64, shape (n, 3)
        mm.
    triangles : ndarray of int64, shape (m, 3)
        Outward.
    patch : ndarray of int64, shape (m,)
        0 is free, 1 held, 2 and on the actuators in their order.
    """

    nodes: FloatArray
    triangles: IntArray
    patch: IntArray


def drawn_surface(experiment: Experiment, most: int = MOST_TRIANGLES) -> PatchedSurface:
    """Return the surface of a body at rest.

    Parameters
    ----------
    experiment : Experiment
        With the body and its patches.
    most : int
        Number of triangles at most.

    Returns
    -------
    PatchedSurface
        Nodes are merged on coarser and coarser grids until there are few enough triangles.
    """
    mesh = experiment.mesh
    patch = np.zeros(len(mesh.surface), np.int64)
    held = [boundary.nodes for boundary in experiment.boundaries] or [mesh.fixed_nodes]
    for number, nodes in [
        *((1, nodes) for nodes in held),
        *((2 + i, actuator.nodes) for i, actuator in enumerate(experiment.actuators)),
    ]:
        patch[np.isin(mesh.surface, nodes).all(axis=1)] = number
    used, triangles = np.unique(mesh.surface, return_inverse=True)
    found = PatchedSurface(mesh.nodes[used], triangles.reshape(-1, 3), patch)
    width = mesh.extent / 80.0
    while len(found.triangles) > most:
        found = _joined(found, width)
        width *= 1.25
    return found


def _joined(surface: PatchedSurface, width: float) -> PatchedSurface:
    """Return the surface with all nodes of a grid cell replaced by their mean."""
    cells = np.floor((surface.nodes - surface.nodes.min(axis=0)) / width).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    nodes = np.stack([np.bincount(group, surface.nodes[:, axis]) / count for axis in range(3)], axis=1)
    triangles = group[surface.triangles]
    whole = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    return PatchedSurface(nodes, triangles[whole], surface.patch[whole])
