"""scikit-fem with MKL Pardiso: forms of this script, full Newton, steps halved while an element turns over."""

import argparse

import numpy as np
import skfem
from skfem.helpers import ddot, grad, identity, mul, trace, transpose

import common


def cold(problem: dict, options: argparse.Namespace) -> common.Found:
    mesh = skfem.MeshTet(problem["nodes_mm"].T.copy(), problem["tets"].T.astype(np.int64).copy())
    shape, order = (skfem.ElementTetP2(), 2) if options.element == "tet10" else (skfem.ElementTetP1(), 1)
    basis = skfem.Basis(mesh, skfem.ElementVector(shape), intorder=order)
    mu, lame = common.lame(problem)

    @skfem.LinearForm
    def internal(v, w):
        # P = mu (F - F^-T) + lambda ln J F^-T, written with what is kept for all quadrature points
        return ddot(w["stress"], grad(v))

    @skfem.BilinearForm
    def stiffness(u, v, w):
        inverse = w["inverse"]
        a, b = mul(grad(u), inverse), mul(grad(v), inverse)
        return mu * ddot(grad(u), grad(v)) + w["factor"] * ddot(transpose(a), b) + lame * trace(a) * trace(b)

    load = np.zeros(basis.N)
    load[basis.nodal_dofs] = problem["forces_mN"].T
    held = np.zeros(mesh.nvertices, dtype=bool)
    held[problem["fixed_nodes"]] = True
    fixed = [basis.nodal_dofs[:, held].ravel()]
    if options.element == "tet10":  # an edge between held nodes is held, as in ours
        fixed.append(basis.edge_dofs[:, held[mesh.edges].all(axis=0)].ravel())
    free = basis.complement_dofs(np.concatenate(fixed))
    scale, solver, u = np.linalg.norm(load[free]), common.Pardiso(), np.zeros(basis.N)

    def state(u):
        gradient = basis.interpolate(u).grad
        deformed = gradient + identity(gradient)
        jacobian = np.linalg.det(np.moveaxis(deformed, (0, 1), (-2, -1)))
        if jacobian.min() <= 0:
            return None
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(deformed, (0, 1), (-2, -1))), (-2, -1), (0, 1))
        factor = mu - lame * np.log(jacobian)
        return {"stress": mu * deformed - factor * transpose(inverse), "inverse": inverse, "factor": factor}

    here = state(u)
    iteration = 0
    while True:
        right = load - internal.assemble(basis, stress=here["stress"])
        off = float(np.linalg.norm(right[free]) / scale)
        if off < options.tolerance:
            return common.Found(u[basis.nodal_dofs].T, iteration, solver.factorisations, off)
        if iteration == 60:
            message = f"no convergence in {iteration} iterations, residual {off:.1e}"
            raise RuntimeError(message)
        matrix = stiffness.assemble(basis, inverse=here["inverse"], factor=here["factor"])
        step = np.zeros(basis.N)
        step[free] = solver(matrix[free][:, free], right[free])
        share = 1.0
        while (there := state(u + share * step)) is None:
            share /= 2
        u, here, iteration = u + share * step, there, iteration + 1


def about(options: argparse.Namespace) -> dict:
    return {
        "version": f"scikit-fem {skfem.__version__}",
        "settings": "full Newton, steps halved where a tet inverts, Pardiso Cholesky",
    }


if __name__ == "__main__":
    common.run("scikit-fem", cold, about)
