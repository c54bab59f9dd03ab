"""felupe with MKL Pardiso: full Newton in as few load steps as it takes, checked by the residual over the load."""

import argparse
import time

import felupe
import numpy as np
from pypardiso.pardiso_wrapper import PyPardisoError

import common


def cold(problem: dict, options: argparse.Namespace) -> common.Found:
    begin = time.perf_counter()
    mesh = felupe.Mesh(problem["nodes_mm"], problem["tets"], "tetra")
    region = felupe.RegionTetra(mesh)
    if options.element == "tet10":
        mesh = mesh.add_midpoints_edges()
        region = felupe.RegionQuadraticTetra(mesh)
    fields = felupe.FieldContainer([felupe.Field(region, dim=3)])
    mu, lame = common.lame(problem)
    solid = felupe.SolidBody(felupe.NeoHookeCompressible(mu=mu, lmbda=lame), fields)
    forces = np.zeros((mesh.npoints, 3))
    forces[: len(problem["forces_mN"])] = problem["forces_mN"]
    loaded = np.flatnonzero(np.any(forces, axis=1))
    load = felupe.PointLoad(fields, points=loaded, values=forces[loaded])
    held = np.zeros(mesh.npoints, dtype=bool)
    held[problem["fixed_nodes"]] = True
    if options.element == "tet10":  # an edge between held nodes is held, as in ours
        ends = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])
        held[mesh.cells[:, 4:][held[mesh.cells[:, ends]].all(axis=2)]] = True
    bounds = {"base": felupe.dof.Boundary(fields[0], mask=held)}
    fixed, free = felupe.dof.partition(fields, bounds)
    before = time.perf_counter() - begin
    scale = np.linalg.norm(forces.ravel()[free])

    def check(dx, x, f, xtol, ftol, dof1=None, dof0=None, items=None, eps=None):
        off = float(np.linalg.norm(np.asarray(f).ravel()[dof1])) / scale
        return float(np.linalg.norm(dx)), off, off < ftol

    for n_steps in (
        1,
        2,
        4,
        8,
        16,
    ):  # the fewest equal load steps that full Newton takes; those that failed cost nothing
        start, solver, iterations = time.perf_counter(), common.Pardiso(), 0
        fields[0].values[:] = 0.0
        try:
            for step in range(1, n_steps + 1):
                load.update(forces[loaded] * step / n_steps)
                found = felupe.newtonraphson(
                    items=[solid, load],
                    dof0=fixed,
                    dof1=free,
                    ext0=felupe.dof.apply(fields, bounds, fixed),
                    solver=solver,
                    check=check,
                    tol=options.tolerance,
                    verbose=0,
                )
                iterations += found.iterations
        except (felupe.NewtonConvergenceError, PyPardisoError):
            continue
        moved, residual = found.x[0].values[: len(problem["nodes_mm"])], float(found.fnorms[-1])
        seconds = before + time.perf_counter() - start
        return common.Found(moved, iterations, solver.factorisations, residual, seconds, n_steps)
    message = "full Newton fails in 16 load steps"
    raise RuntimeError(message)


def about(options: argparse.Namespace) -> dict:
    return {"version": f"felupe {felupe.__version__}", "settings": "full Newton, fewest load steps, Pardiso Cholesky"}


if __name__ == "__main__":
    common.run("felupe", cold, about)
