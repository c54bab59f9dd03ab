"""Pressed block of `tests/common/incompressible.rs` by felupe: bricks with a pressure and a volume ratio each.

    python make_incompressible.py [--cells 4 8]

Writes `incompressible_felupe.npz` beside itself. mm and MPa; dead load.
"""

import argparse
from pathlib import Path

import felupe as fem
import numpy as np
import tensortrax.math as tm

MU, EDGE, PRESSURE = 1.61148, 50.0, 3.0
LAMBDAS = {"published": 499.92568, "nu_04995": 2 * MU * 0.4995 / (1 - 2 * 0.4995)}
LOAD_STEPS = 6


def pressed(cells: int, lame: float) -> float:
    """Return how far the middle of the pressed patch goes down, mm."""
    mesh = fem.Cube(b=(EDGE,) * 3, n=cells + 1)
    field = fem.FieldsMixed(fem.RegionHexahedron(mesh), n=3)

    def energy(c):
        j = tm.sqrt(tm.linalg.det(c))
        return MU / 2 * (tm.trace(c) - 3 - 2 * tm.log(j)) + lame / 2 * (j - 1) ** 2

    solid = fem.SolidBody(fem.ThreeFieldVariation(fem.Hyperelastic(energy)), field)
    x, y, z = mesh.points.T
    far = EDGE - 1e-9
    masks = {
        "base": (z < 1e-9, (1, 1, 0)),
        "top": (z > far, (0, 0, 1)),
        "x": (x > far, (0, 1, 1)),
        "y": (y > far, (1, 0, 1)),
    }
    bounds = {name: fem.Boundary(field[0], mask=mask, skip=skip) for name, (mask, skip) in masks.items()}
    held, free = fem.dof.partition(field, bounds)
    # Nodes of the patch carry the area around them: a quarter of a cell for each cell that they touch.
    edge = EDGE / cells
    middle = EDGE / 2
    touched = [np.where(v > far, 1, np.where(v > middle + 1e-9, 2, np.where(v > middle - 1e-9, 1, 0))) for v in (x, y)]
    forces = np.zeros_like(mesh.points)
    forces[:, 2] = -PRESSURE * edge**2 / 4 * touched[0] * touched[1] * (z > far)
    loaded = np.flatnonzero(forces[:, 2])
    load = fem.PointLoad(field, loaded, forces[loaded])
    for step in range(1, LOAD_STEPS + 1):
        load.update(forces[loaded] * step / LOAD_STEPS)
        found = fem.newtonraphson(
            items=[solid, load], dof0=held, dof1=free, ext0=fem.dof.apply(field, bounds, held), verbose=0, tol=1e-9
        )
    pressed_node = np.flatnonzero((x > far) & (y > far) & (z > far))[0]
    return -float(found.x[0].values[pressed_node, 2])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[4, 8])
    cells = parser.parse_args().cells
    answers = {name: np.array([pressed(n, lame) for n in cells]) for name, lame in LAMBDAS.items()}
    print(cells, answers)
    np.savez(Path(__file__).with_name("incompressible_felupe.npz"), cells=cells, **answers)
