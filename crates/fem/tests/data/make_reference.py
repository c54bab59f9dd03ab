"""Solve a small bent bar with scikit-fem, for `tests/reference.rs`.

    python make_reference.py          # writes bar_reference.npz

A bar of 30 x 10 x 10 mm with moved inner nodes, clamped at x = 0, under its own weight and a dead
nodal load at its tip; compressible neo-Hookean solid; Newton to a residual of 1e-13 of the load.
Needs numpy, scipy and scikit-fem.
"""

import itertools

import numpy as np
import skfem
from skfem.helpers import dot, grad

YOUNG, POISSON = 10.0, 0.45
BODY_FORCE = np.array([0.0, 0.0, -9.81e-3])
TIP_FORCE = np.array([0.0, 4.0, -6.0])
MU = YOUNG / (2 * (1 + POISSON))
LAMBDA = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))


def bar():
    """Return nodes (n, 3) and tetrahedra (m, 4): every cube cut into six along its diagonal."""
    cells = (6, 2, 2)
    grid = np.stack(np.meshgrid(*[np.arange(c + 1) for c in cells], indexing="ij"), axis=-1)
    nodes = grid.reshape(-1, 3) * 5.0
    rng = np.random.default_rng(7)
    inner = ((nodes > 0) & (nodes < np.array(cells) * 5.0)).all(axis=1)
    nodes[inner] += rng.uniform(-1.0, 1.0, (inner.sum(), 3))
    index = np.arange(len(nodes)).reshape(grid.shape[:3])
    tets = []
    for i, j, k in itertools.product(*map(range, cells)):
        for order in itertools.permutations(range(3)):
            corner = np.array([i, j, k])
            path = [index[tuple(corner)]]
            for axis in order:
                corner = corner + np.eye(3, dtype=int)[axis]
                path.append(index[tuple(corner)])
            a, b, c, d = nodes[path]
            if np.linalg.det(np.stack([b - a, c - a, d - a])) < 0:
                path[1], path[2] = path[2], path[1]
            tets.append(path)
    return nodes, np.array(tets)


def kinematics(du):
    f = du + np.eye(3)[:, :, None, None]
    j = np.linalg.det(np.moveaxis(f, (0, 1), (-2, -1)))
    inverse = np.moveaxis(np.linalg.inv(np.moveaxis(f, (0, 1), (-2, -1))), (-2, -1), (0, 1))
    return f, j, inverse


@skfem.LinearForm
def internal(v, w):
    f, j, inverse = kinematics(w["u"].grad)
    inverse_t = np.swapaxes(inverse, 0, 1)
    stress = MU * (f - inverse_t) + LAMBDA * np.log(j) * inverse_t
    return np.einsum("ij...,ij...->...", stress, grad(v))


@skfem.BilinearForm
def tangent(u, v, w):
    _, j, inverse = kinematics(w["u"].grad)
    du, dv = grad(u), grad(v)
    left = np.einsum("ji...,ij...->...", inverse, dv)
    right = np.einsum("ji...,ij...->...", inverse, du)
    # dP = mu dh + (mu - lambda ln J) F^-T dh^T F^-T + lambda (F^-T : dh) F^-T
    twisted = np.einsum("ji...,kj...,lk...->il...", inverse, du, inverse)
    return (
        MU * np.einsum("ij...,ij...->...", du, dv)
        + (MU - LAMBDA * np.log(j)) * np.einsum("ij...,ij...->...", twisted, dv)
        + LAMBDA * left * right
    )


@skfem.LinearForm
def weight(v, w):
    return dot(BODY_FORCE[:, None, None] * np.ones_like(w.x), v)


def solve(mesh, element, order):
    """Return the displacement at the corner nodes (n, 3)."""
    basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=order)
    load = weight.assemble(basis)
    tip = np.argmax(mesh.p.sum(axis=0))
    load[basis.nodal_dofs[:, tip]] += TIP_FORCE
    fixed = basis.get_dofs(lambda x: x[0] < 1e-9).all()
    u = np.zeros(basis.N)
    free = np.setdiff1d(np.arange(basis.N), fixed)
    for fraction in (*np.linspace(0.1, 1.0, 10), 1.0):
        for _ in range(30):
            state = basis.interpolate(u)
            residual = internal.assemble(basis, u=state) - fraction * load
            if np.linalg.norm(residual[free]) < 1e-13 * np.linalg.norm(load[free]):
                break
            matrix = tangent.assemble(basis, u=state)
            u += skfem.solve(*skfem.condense(matrix, -residual, D=fixed))
    print(type(element).__name__, "residual", np.linalg.norm(residual[free]), "largest", np.abs(u).max())
    return u[basis.nodal_dofs].T


def main():
    nodes, tets = bar()
    mesh = skfem.MeshTet(nodes.T, tets.T)
    assert np.array_equal(mesh.p.T, nodes)
    tip = int(np.argmax(nodes.sum(axis=1)))
    forces = np.zeros_like(nodes)
    forces[tip] = TIP_FORCE
    np.savez_compressed(
        "bar_reference.npz",
        nodes_mm=nodes,
        tets=tets.astype(np.int32),
        fixed_nodes=np.flatnonzero(nodes[:, 0] < 1e-9).astype(np.int32),
        forces_mN=forces,
        body_force=BODY_FORCE,
        young_kPa=YOUNG,
        poisson=POISSON,
        displacement_tet4_mm=solve(mesh, skfem.ElementTetP1(), 1),
        displacement_tet10_mm=solve(mesh, skfem.ElementTetP2(), 2),
    )


if __name__ == "__main__":
    main()
