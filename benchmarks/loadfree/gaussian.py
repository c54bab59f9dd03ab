r"""A Gaussian field of tractions on the free surface, to first order: image-to-physical registration in LIBR's spirit.

Tractions t ~ N(0, s^2 exp(-|x - x'|^2 / 2 l^2) I) at the free surface's nodes make forces A t (A: lumped areas). With
the response H of markers to nodal forces at rest, displacements d of the markers are

    d ~ N(0, s^2 H A K A H' + noise^2 I),

whose evidence chooses l and s; targets follow in closed form. Nothing is sparse, nothing is nonlinear.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from loadfree.events import Body, read_body
from tissuereg import Load, Material, Simulator
from tissuereg.simulation.sensitivity import Linearised, Observation

#: Lengths over the body's extent, and root mean square tractions in kPa, that are tried.
LENGTHS = (0.06, 0.1, 0.16, 0.25, 0.4)
SIZES = tuple(np.geomspace(0.003, 30.0, 33))


@dataclass(frozen=True, eq=False)
class Responses:
    """A body to first order: what its pool, its targets and its nodes do under tractions.

    Attributes
    ----------
    at_rest : Linearised
    free : ndarray of int
        Nodes of the free surface.
    loads : list of ndarray, shape (3 n_places, n_free, 3)
        By length: covariance of observations (pool first, then targets, by component) and nodal forces, at s = 1.
    covariances : list of ndarray, shape (3 n_places, 3 n_places)
        By length: covariance of observations at s = 1.
    """

    at_rest: Linearised
    free: np.ndarray
    loads: list
    covariances: list


@cache
def responses(name: str) -> Responses:
    """Return a body's responses, computed once in a process."""
    body = read_body(name)
    mesh, material = body.mesh, Material()
    at_rest = Linearised(Simulator(mesh), Load(), material, np.zeros((mesh.n_nodes, 3)), threads=1)
    free, area = _free_surface(mesh)
    seen = np.concatenate([_rows(at_rest, *on_surface(body)), _rows(at_rest, *in_tets(body))])[:, free]
    loads, covariances = [], []
    off = np.linalg.norm(mesh.nodes[free][:, None] - mesh.nodes[free], axis=2)
    for share in LENGTHS:
        kernel = np.exp(-0.5 * (off / (share * mesh.extent)) ** 2) * area * area[:, None]
        load = np.tensordot(seen, kernel, axes=(1, 0)).transpose(0, 2, 1)
        loads.append(load.astype(np.float32))
        covariances.append(load.reshape(len(seen), -1) @ seen.reshape(len(seen), -1).T)
    return Responses(at_rest, free, loads, covariances)


def gaussian_answer(
    body: Body, places: np.ndarray, displacement: np.ndarray, noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return displacements at nodes (n, 3) and targets (k, 3) and the targets' covariances (k, 3, 3).

    Parameters
    ----------
    body : Body
    places : ndarray of int, shape (m,)
        Places of the pool that carry markers.
    displacement : ndarray, shape (m, 3)
        What the markers did, mm.
    noise : float
        Standard deviation of a component, mm.
    """
    found, rows = responses(body.name), (3 * places[:, None] + np.arange(3)).ravel()
    inner = np.arange(3 * len(body.pool), 3 * (len(body.pool) + len(body.targets)))
    measured = displacement.ravel()
    best = max(
        (_evidence(covariance[np.ix_(rows, rows)], measured, size, noise), -length, size)
        for length, covariance in enumerate(found.covariances)
        for size in SIZES
    )
    length, size = -best[1], best[2]
    covariance = size**2 * found.covariances[length]
    inverse = np.linalg.inv(covariance[np.ix_(rows, rows)] + noise**2 * np.eye(len(rows)))
    gain = covariance[np.ix_(inner, rows)] @ inverse
    left = covariance[np.ix_(inner, inner)] - gain @ covariance[np.ix_(rows, inner)]
    k = len(body.targets)
    spread = np.stack([left[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(k)])
    forces = np.zeros((body.mesh.n_nodes, 3))
    forces[found.free] = size**2 * np.tensordot(inverse @ measured, found.loads[length][rows], axes=1)
    nodes = found.at_rest.derivatives([Load(forces=forces)]).displacement[0]
    return nodes, (gain @ measured).reshape(k, 3), spread


def _evidence(covariance: np.ndarray, measured: np.ndarray, size: float, noise: float) -> float:
    whole = size**2 * covariance + noise**2 * np.eye(len(measured))
    return float(-0.5 * (np.linalg.slogdet(whole)[1] + measured @ np.linalg.solve(whole, measured)))


def _free_surface(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the free surface's nodes off the base and their lumped areas, mm^2."""
    triangles = mesh.surface[~np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)]
    corners = mesh.nodes[triangles]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    area = np.zeros(mesh.n_nodes)
    np.add.at(area, triangles.ravel(), np.repeat(sizes / 3, 3))
    area[mesh.fixed_nodes] = 0.0
    free = np.flatnonzero(area)
    return free, area[free]


def _rows(at_rest: Linearised, nodes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return how each component at each place follows nodal forces, (3 n_places, n_nodes, 3)."""
    seen = [
        Observation(some, weight[:, None] * np.eye(3)[component])
        for some, weight in zip(nodes, weights, strict=True)
        for component in range(3)
    ]
    return np.concatenate([at_rest.adjoints(seen[i : i + 60]).forces for i in range(0, len(seen), 60)])


def on_surface(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights (n_places, 3) of the pool's places in the surface's triangles."""
    mesh = body.mesh
    corners = mesh.nodes[mesh.surface]
    sides = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.pinv(np.swapaxes(sides, 1, 2))
    return _weights(mesh.surface, corners, inverse, body.pool)


def in_tets(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights (n_targets, 4) of the targets in their tetrahedra."""
    mesh = body.mesh
    corners = mesh.nodes[mesh.tets]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    return _weights(mesh.tets, corners, inverse, body.targets)


def _weights(
    cells: np.ndarray, corners: np.ndarray, inverse: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = [], []
    for point in points:
        local = np.einsum("mij,mj->mi", inverse, point - corners[:, 0])
        shares = np.concatenate([1 - local.sum(axis=1, keepdims=True), local], axis=1)
        shares = np.clip(shares, 0.0, None)
        shares /= shares.sum(axis=1, keepdims=True)
        off = np.linalg.norm(np.einsum("ma,max->mx", shares, corners) - point, axis=1)
        best = int(off.argmin())
        nodes.append(cells[best])
        weights.append(shares[best])
    return np.array(nodes), np.array(weights)
