"""Vibration modes of a supported body at rest, by its elasticity and by the weights of ADMM."""

from dataclasses import dataclass

import numpy as np

from tissuereg import Material, Mesh, Simulator
from tissuereg._base.arrays import FloatArray, frozen
from tissuereg.errors import SupportError


@dataclass(frozen=True, eq=False)
class Modes:
    """The slowest vibrations of a body.

    Attributes
    ----------
    shapes : ndarray of float64, shape (n_modes, n_nodes, 3)
        Displacement of the nodes over the amplitude, 1/sqrt(kg); zero at held nodes. Shapes are orthonormal in the
        mass: ``sum_n m_n shapes[j, n] . shapes[k, n]`` is one for ``j = k`` and zero otherwise.
    squares : ndarray of float64, shape (n_modes,)
        Squared angular frequencies, 1/s^2, ascending.
    """

    shapes: FloatArray
    squares: FloatArray


def vibration_modes(mesh: Mesh, material: Material, masses: FloatArray, n_modes: int, threads: int = 0) -> Modes:
    """Return the slowest modes ``K phi = omega^2 M phi`` of four-node tets at rest, with masses lumped at the nodes.

    Parameters
    ----------
    mesh : Mesh
        Undeformed body; its node set ``fixed`` is held.
    material : Material
        Young's modulus and Poisson's ratio; of all laws with these the stiffness at rest is the same.
    masses : ndarray of float64, shape (n_nodes,)
        Mass of every node, kg.
    n_modes : int
        Number of modes; no more are returned than the body has free components.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    Modes
        The largest component of every shape is positive.

    Raises
    ------
    SupportError
        If the body can move freely.

    Notes
    -----
    Lanczos' method on ``M^(1/2) K^-1 M^(1/2)``, whose largest eigenvalues are ``1/omega^2``: some three solutions
    with one factor per mode. A body with few free components is treated as a full matrix.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    simulator = Simulator(mesh)
    young, poisson = simulator.moduli(material)
    rest = simulator.body.linearise(np.zeros_like(mesh.nodes), young, poisson, threads=threads)
    free = np.ones(mesh.n_nodes, dtype=bool)
    free[mesh.fixed_nodes] = False
    roots = np.repeat(np.sqrt(masses[free]), 3)
    n_free = len(roots)

    def scaled_response(forces: FloatArray) -> FloatArray:
        """Return M^(1/2) K^-1 M^(1/2) f for rows (n, n_free)."""
        fields = np.zeros((len(forces), mesh.n_nodes, 3))
        fields[:, free] = (roots * forces).reshape(len(forces), -1, 3)
        return np.asarray(roots * rest.responses(fields)[:, free].reshape(len(forces), -1))

    count = min(n_modes, n_free)
    if 2 * count + 1 >= n_free:
        full = scaled_response(np.eye(n_free))
        values, vectors = np.linalg.eigh(0.5 * (full + full.T))
        values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    else:
        operator = LinearOperator(
            (n_free, n_free), matvec=lambda v: scaled_response(v.reshape(1, -1))[0], dtype=np.float64
        )
        # A start that is given, so that the same body has the same bits.
        start = np.random.default_rng(0).standard_normal(n_free)
        values, vectors = eigsh(operator, k=count, which="LA", v0=start)
        order = np.argsort(values)[::-1]
        values, vectors = values[order], vectors[:, order]
    vectors = _upright(vectors / roots[:, None])
    shapes = np.zeros((count, mesh.n_nodes, 3))
    shapes[:, free] = vectors.T.reshape(count, -1, 3)
    return Modes(frozen(shapes), frozen(1.0 / values))


def admm_modes(mesh: Mesh, material: Material, masses: FloatArray, n_modes: int, threads: int = 0) -> Modes:
    """Return the slowest modes ``D' W^2 D phi = omega^2 M phi`` of a body as the global step of ADMM has it.

    In it, components do not know of each other: every mode is one of a scalar field, along x, y or z. Arguments and
    answer are those of `vibration_modes`, of which `threads` is not used.

    Raises
    ------
    SupportError
        If no node is held.

    Notes
    -----
    ``W^2`` of a tet is its volume times ``lambda + 2 mu / 3``. Cost: one factor of a scalar matrix, and Lanczos' method
    on a third of the modes.
    """
    from scipy import sparse
    from scipy.sparse.linalg import eigsh

    free = np.setdiff1d(np.arange(mesh.n_nodes), mesh.fixed_nodes)
    if len(free) == mesh.n_nodes:
        message = "the mesh must have held nodes; its node set `fixed` is empty"
        raise SupportError(message, where="mesh")
    young, poisson = Simulator(mesh).moduli(material)
    bulk = np.broadcast_to(young / (3.0 * (1.0 - 2.0 * poisson)), mesh.n_tets)
    corners = mesh.nodes[mesh.tets]
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    slopes = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2)
    blocks = np.einsum("e,exi,exj->eij", bulk * mesh.volumes, slopes, slopes)
    rows, columns = np.repeat(mesh.tets, 4, axis=1).ravel(), np.tile(mesh.tets, (1, 4)).ravel()
    whole = sparse.csr_array((blocks.ravel(), (rows, columns)), (mesh.n_nodes, mesh.n_nodes))
    roots = np.sqrt(masses[free])
    scaled = sparse.diags_array(1.0 / roots) @ whole[free][:, free] @ sparse.diags_array(1.0 / roots)
    count = min((n_modes + 2) // 3, len(free))
    if 2 * count + 1 >= len(free):
        squares, vectors = (part[..., :count] for part in np.linalg.eigh(scaled.toarray()))
    else:
        start = np.random.default_rng(0).standard_normal(len(free))
        squares, vectors = eigsh(sparse.csc_array(scaled), k=count, sigma=0.0, which="LM", v0=start)
    vectors = _upright(vectors / roots[:, None])
    shapes = np.zeros((count, 3, mesh.n_nodes, 3))
    for axis in range(3):
        shapes[:, axis, free, axis] = vectors.T
    last = min(n_modes, 3 * len(free))
    return Modes(frozen(shapes.reshape(-1, mesh.n_nodes, 3)[:last]), frozen(np.repeat(squares, 3)[:last]))


def _upright(vectors: FloatArray) -> FloatArray:
    """Return columns with the sign that makes the largest component positive: eigenvectors have none of their own."""
    largest = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(vectors.shape[1])]
    return np.asarray(vectors * np.sign(largest))
