"""The truth by scikit-fem: ten-node tetrahedra on curved geometry, stresses and tangents written out."""

import numpy as np
import skfem
from pypardiso import PyPardisoSolver
from scipy.sparse import coo_matrix, csr_matrix

from rigs.generator.meshing import EDGES, arrays_of, outer_faces
from rigs.generator.skeleton import Skeleton
from rigs.generator.truth import Truth, moduli

ID = np.eye(3)


class Factors:
    """Factors of a sparse matrix, whose memory is given back with the object."""

    def __init__(self, matrix):
        self.matrix, self.solver = matrix, PyPardisoSolver()
        self.solver.factorize(matrix)

    def __del__(self):
        self.solver.free_memory(everything=True)

    def solve(self, right):
        """Return the solution for a right side."""
        return self.solver.solve(self.matrix, right)


class SkSolver:
    """Equilibria of one rig's mesh under one truth; only elastic truths.

    `rig`: Rig; `mesh`: netgen mesh; `bent` (n, 3): where the middles of edges lie on the curved body, by the sorted
    corners of the edge.
    """

    code = "scikit-fem"

    def __init__(self, rig, mesh, bent):
        self.rig = rig
        nodes, tets = arrays_of(mesh)
        straight = skfem.MeshTet(nodes.T.copy(), tets.T.copy())
        curved = skfem.MeshTet2.from_mesh(straight)
        edges = np.sort(straight.edges.T, axis=1)
        places = curved.doflocs.copy()
        at = {tuple(e): k for k, e in enumerate(edges)}
        n_corners = len(nodes)
        for pair, middle in bent.items():
            places[:, n_corners + at[pair]] = middle
        curved = skfem.MeshTet2(places, straight.t)
        basis = skfem.Basis(curved, skfem.ElementTetP2(), intorder=2)
        functions = basis.element_dofs.T
        where = basis.doflocs.T
        # Functions of corners come first, in the order of corners; those of edges in the order of `edges`.
        tets = straight.t.T
        ten = np.concatenate(
            [tets, n_corners + np.array([[at[tuple(sorted(t[list(p)]))] for p in EDGES] for t in tets])], 1
        )
        order = np.argsort(functions, axis=1), np.argsort(ten, axis=1)
        assert np.array_equal(np.take_along_axis(functions, order[0], 1), np.take_along_axis(ten, order[1], 1))
        places = places.T.copy()
        assert np.allclose(where[:n_corners], places[:n_corners])
        triangles, _ = outer_faces(tets)
        faces = [
            [a, b, c, *(n_corners + at[tuple(sorted(p))] for p in ((a, b), (a, c), (b, c)))] for a, b, c in triangles
        ]
        self.skeleton = Skeleton(places, ten, np.array(faces), 4.0, nodal=True)
        self.functions, self.dx = functions, basis.dx
        self.gradients = np.stack([np.asarray(basis.basis[a][0].grad) for a in range(10)])  # (10, 3, m, q)
        self.values = np.stack([np.asarray(basis.basis[a][0]) for a in range(10)])
        self.points = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)  # (m, q, 3)
        self.n = len(places)
        dofs = (3 * functions[:, :, None] + np.arange(3)).reshape(len(functions), 30)
        self.rows, self.columns = np.repeat(dofs, 30, axis=1).ravel(), np.tile(dofs, (1, 30)).ravel()
        self.dofs = dofs
        self.basis, self.curved = basis, curved

    def start(self, truth: Truth):
        """Take a truth."""
        self.truth = truth
        if truth.timed or truth.wall or truth.thread:
            message = "truth must be elastic and without contact for scikit-fem"
            raise ValueError(message)
        flat = self.points.reshape(-1, 3)
        factor = 1.0 if truth.contrast is None else truth.contrast(flat).reshape(self.dx.shape)
        self.scaled = self.dx * factor
        self.load = np.zeros((self.n, 3))
        if truth.weight is not None:
            share = np.einsum("amq,mq->ma", np.broadcast_to(self.values, (10, *self.dx.shape)), self.dx)
            np.add.at(self.load, self.functions, share[..., None] * np.asarray(truth.weight))
        self.ties = None
        support = truth.support or {}
        if "springs" in support:
            self.ties = support["springs"] * self._surface_mass()

    def _surface_mass(self):
        mesh = self.curved
        middles = mesh.p[:, mesh.facets].mean(axis=1).T
        boundary = mesh.boundary_facets()
        chosen = boundary[np.any([h.inside(middles[boundary]) for h in self.rig.holds], axis=0)]
        surface = skfem.FacetBasis(mesh, skfem.ElementTetP2(), facets=chosen, intorder=4)
        return skfem.BilinearForm(lambda u, v, _: u * v).assemble(surface).tocsr()

    def refresh(self, u):
        """Nothing is remembered."""

    def set_time(self, step, time):
        """Nothing depends on time."""

    def _strain(self, u):
        return np.einsum("mai,ajmq->mqij", u[self.functions], self.gradients) + ID

    def residual(self, u):
        """Return the forces (n, 3) that hold a state."""
        with np.errstate(invalid="ignore", over="ignore"):
            stress = law(self.rig, self.truth, self._strain(u), False)
        local = np.einsum("mqij,ajmq,mq->mai", stress, self.gradients, self.scaled)
        out = -self.load.copy()
        np.add.at(out, self.functions, local)
        if self.ties is not None:
            out += self.ties @ u
        return out

    def tangent(self, u, free):
        """Return functions that multiply by the tangent, and that solve with it on free components (n, 3)."""
        _, slope = law(self.rig, self.truth, self._strain(u), True)
        m, q = self.dx.shape
        # Columns of the gradient's nine components by the thirty unknowns.
        wide = np.zeros((m, q, 3, 3, 10, 3))
        moved = np.moveaxis(self.gradients, (2, 3), (0, 1))  # (m, q, 10, 3)
        for i in range(3):
            wide[:, :, i, :, :, i] = np.swapaxes(moved, 2, 3)
        wide = wide.reshape(m, q, 9, 30)
        weighted = slope.reshape(m, q, 9, 9) * self.scaled[..., None, None]
        local = np.matmul(np.swapaxes(wide, 2, 3), np.matmul(weighted, wide)).sum(axis=1)
        matrix = coo_matrix((local.ravel(), (self.rows, self.columns)), shape=(3 * self.n, 3 * self.n)).tocsr()
        if self.ties is not None:
            ties = self.ties.tocoo()
            for i in range(3):
                matrix = matrix + csr_matrix((ties.data, (3 * ties.row + i, 3 * ties.col + i)), shape=matrix.shape)
        kept = np.flatnonzero(free.ravel())
        inner = matrix[kept][:, kept].tocsr()
        factors = Factors(inner)

        def solve(v):
            out = np.zeros(3 * self.n)
            out[kept] = factors.solve(np.ascontiguousarray(v.ravel()[kept]))
            return out.reshape(-1, 3)

        return lambda v: (matrix @ v.ravel()).reshape(-1, 3), solve


def law(rig, truth, f, tangent):
    """Return the first Piola-Kirchhoff stress (..., 3, 3), and its derivative (..., 3, 3, 3, 3) if asked for.

    Energies are w(I1, ln J); with Mooney's second invariant for that law.
    """
    mu, lam, bulk = moduli(rig, truth)
    name, shape = truth.law or rig.law
    det = np.linalg.det(f)
    det = np.where(det > 0, det, np.nan)
    log_j, inverse = np.log(det), np.swapaxes(np.linalg.inv(np.where(np.isnan(det)[..., None, None], ID, f)), -1, -2)
    first = np.einsum("...ij,...ij->...", f, f)
    one, two = (x[..., None, None] for x in _by_first(name, shape, mu, lam, bulk, first, log_j))
    # w1 = dw/dI1, w2 = dw/d(ln J); P = 2 w1 F + w2 F^-T.
    stress = 2 * one * f + two * inverse
    if not tangent:
        return stress
    a11, a12, a22 = (x[..., None, None, None, None] for x in _second(name, shape, mu, lam, bulk, first, log_j))
    ff = np.einsum("...ij,...kl->...ijkl", f, f)
    fg = np.einsum("...ij,...kl->...ijkl", f, inverse)
    gg = np.einsum("...ij,...kl->...ijkl", inverse, inverse)
    slope = 4 * a11 * ff + 2 * a12 * (fg + np.einsum("...ijkl->...klij", fg)) + a22 * gg
    slope = slope + 2 * one[..., None, None] * np.einsum("ik,jl->ijkl", ID, ID)
    return stress, slope - two[..., None, None] * np.einsum("...il,...kj->...ijkl", inverse, inverse)


def _by_first(name, shape, mu, lam, bulk, first, log_j):
    if name == "neo-hookean":
        return np.full_like(first, mu / 2), lam * log_j - mu
    ring, fall = first * np.exp(-2 / 3 * log_j), np.exp(-2 / 3 * log_j)
    if name == "fung":
        slope = mu / 2 * np.exp(shape["b"] * (ring - 3))
        return slope * fall, bulk * log_j - 2 / 3 * slope * ring
    if name == "exponential":
        slope = mu / 2 * np.exp(shape["b"] * (first - 3 - 2 * log_j))
        return slope, lam * log_j - 2 * slope
    message = f"law must be known to scikit-fem's solver, got {name}"
    raise ValueError(message)


def _second(name, shape, mu, lam, bulk, first, log_j):
    zero = np.zeros_like(first)
    if name == "neo-hookean":
        return zero, zero, zero + lam
    if name == "fung":
        ring, fall = first * np.exp(-2 / 3 * log_j), np.exp(-2 / 3 * log_j)
        slope = mu / 2 * np.exp(shape["b"] * (ring - 3))
        bend = shape["b"] * slope
        mixed = -2 / 3 * fall * (bend * ring + slope)
        return bend * fall**2, mixed, bulk + 4 / 9 * ring * (bend * ring + slope)
    slope = mu / 2 * np.exp(shape["b"] * (first - 3 - 2 * log_j))
    bend = shape["b"] * slope
    return bend, -2 * bend, lam + 4 * bend


def bent_edges(skeleton):
    """Return where the middles of edges lie, by their sorted corners, from a skeleton of NGSolve."""
    found = {}
    for k, pair in enumerate(EDGES):
        functions = skeleton.tets[:, 4 + k]
        corners = np.sort(skeleton.tets[:, pair], axis=1)
        middle = skeleton.places[corners].mean(axis=1) + skeleton.bulge / 4 * skeleton.places[functions]
        found.update(zip(map(tuple, corners), middle, strict=True))
    return found
