"""Third meshes: the same body on meshes with other discretisation errors than the fine one, to calibrate false alarms.

The difference between two meshes of equal size is about as large as the error of either. Therefore inner nodes are
moved by up to a quarter of their shortest edge, surface nodes slide equally far along the facets, and the elements at
the rims of the pads get another size, which determines how well the stress peak there is resolved. Flat facets cut a
part off a curved body; so the surface is moved outwards where it is convex, by a share of the gap between facets and a
smooth surface.
"""

from dataclasses import replace

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.fine.bisection import shape_quality
from tissuereg.simulation.fine.meshing import FineMeshing, rim_of
from tissuereg.simulation.fine.model import FineModel
from tissuereg.simulation.fine.rims import folds_of, sharp_nodes
from tissuereg.simulation.settings import FINE


def third_meshes(experiment: Experiment, n: int, seed: int, *, meshing: FineMeshing | None = None) -> list[FineModel]:
    """Return fine models of one experiment, each on a randomly changed mesh with other discretisation errors.

    Parameters
    ----------
    experiment : Experiment
        The believed model (as the user states it), on the mesh that its fine model was made from.
    n : int
        Number of models.
    seed : int
        Seed of all random numbers.
    meshing : FineMeshing, optional
        Settings of the fine model.

    Returns
    -------
    list of FineModel
        The models; the first `n` are the same for any larger `n`.
    """
    meshing = meshing or FineMeshing()
    models = []
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        other = replace(meshing, rim_edge=meshing.rim_edge * rng.uniform(*FINE.rim_factors))
        models.append(FineModel(replace(experiment, mesh=jittered(experiment, rng)), other))
    return models


def jittered(experiment: Experiment, rng: np.random.Generator) -> Mesh:
    """Return the mesh of an experiment with its nodes moved at random.

    `experiment`: the experiment; nodes of its boundaries, of pads that are not given by a ball, and on edges of the
    body stay; `rng`: source of random numbers. Result: the same tets and sets; every tet keeps half of its shape
    quality (mean ratio) at least.
    """
    mesh = experiment.mesh
    shortest = _shortest_edges(mesh)
    step = rng.standard_normal(mesh.nodes.shape)
    step *= (FINE.jitter_share * shortest * np.cbrt(rng.random(mesh.n_nodes)) / np.linalg.norm(step, axis=1))[:, None]
    outwards = rng.uniform(*FINE.bulge_shares) * gaps(mesh)
    step[mesh.surface_nodes] = (_slides(mesh, shortest, rng) + outwards)[mesh.surface_nodes]
    given = [boundary.nodes for boundary in experiment.boundaries]
    given += [pad.nodes for pad in experiment.actuators if rim_of(pad) is None]
    step[np.unique(np.concatenate([sharp_nodes(mesh.nodes, mesh.surface), *given]))] = 0.0
    wanted = FINE.kept_quality * shape_quality(mesh.nodes, mesh.tets)
    while (spoilt := shape_quality(mesh.nodes + step, mesh.tets) < wanted).any():
        step[mesh.tets[spoilt]] *= 0.5
    return Mesh(mesh.nodes + step, mesh.tets, mesh.node_sets)


def _shortest_edges(mesh: Mesh) -> FloatArray:
    """Return the length of the shortest edge at every node, shape (n_nodes,), in mm."""
    length = np.linalg.norm(mesh.nodes[mesh.edges[:, 0]] - mesh.nodes[mesh.edges[:, 1]], axis=1)
    shortest = np.full(mesh.n_nodes, np.inf)
    for end in (0, 1):
        np.minimum.at(shortest, mesh.edges[:, end], length)
    return shortest


def _slides(mesh: Mesh, shortest: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return random steps (n_nodes, 3), mm, of surface nodes, each along one of its facets; zero inside the body.

    `shortest` (n_nodes,): shortest edge at every node, mm; a step is at most a quarter of it.
    """
    triangles: IntArray = mesh.surface[rng.permutation(len(mesh.surface))]
    step = np.zeros_like(mesh.nodes)
    for corner in range(3):
        others = mesh.nodes[triangles[:, [corner - 1, corner - 2]]].mean(axis=1)
        along = others - mesh.nodes[triangles[:, corner]]
        # Of several facets the last one written counts.
        step[triangles[:, corner]] = along / np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(step * (FINE.jitter_share * shortest * np.sqrt(rng.random(mesh.n_nodes)))[:, None])


def gaps(mesh: Mesh) -> FloatArray:
    """Return the mean gap between the flat facets and a smooth surface at every node, as vectors (n_nodes, 3) in mm.

    `mesh`: reference shape. The vectors point outward where the body is convex, inward where it is concave; they are
    zero inside, on flat faces and at sharp edges.

    Notes
    -----
    Facets of edge L on a surface of curvature k lie k L^2 / 8 below it on average; k is the angle between two facets
    over the distance of their centres.
    """
    surface = mesh.surface
    folds = folds_of(mesh.nodes, surface)
    edges, (first, second) = folds.edges, folds.facets.T
    centres = mesh.nodes[surface].mean(axis=1)
    across = centres[second] - centres[first]
    angle = np.arccos(folds.cosines) * -np.sign((across * folds.normals[first]).sum(axis=1))
    squares = ((mesh.nodes[edges[:, 0]] - mesh.nodes[edges[:, 1]]) ** 2).sum(axis=1)
    gap = angle * squares / (8.0 * np.linalg.norm(across, axis=1))
    gap[folds.is_sharp] = 0.0
    total, count, out = np.zeros(mesh.n_nodes), np.zeros(mesh.n_nodes), np.zeros_like(mesh.nodes)
    for end in (0, 1):
        np.add.at(total, edges[:, end], gap)
        np.add.at(count, edges[:, end], 1.0)
    for corner in range(3):
        np.add.at(out, surface[:, corner], folds.normals)
    length = np.maximum(np.linalg.norm(out, axis=1), np.finfo(float).tiny)
    return np.asarray(out * (total / np.maximum(count, 1.0) / length)[:, None])
