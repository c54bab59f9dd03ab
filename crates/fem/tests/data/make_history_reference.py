"""Load, unload and reload a softening bar with felupe, for `tests/reference.rs`.

    python make_history_reference.py          # writes history_reference.npz

The bar and the nodal load of `bar_reference.npz`, four-node tetrahedra; neo-Hookean solid whose isochoric part softens
after Ogden and Roxburgh; Newton to a residual of 1e-11 of the load. Needs numpy, felupe and tensortrax.
"""

import pathlib

import felupe as fem
import numpy as np
import tensortrax.math as tm

HERE = pathlib.Path(__file__).parent
FACTORS = [0.5, 1.5, 0.6, 0.1, 1.0, 2.0]
R, M_KPA, BETA = 1.6, 0.02, 0.15


def volumetric(c, mu, lmbda):
    """Energy of the neo-Hookean law less that of its volume-preserving deformation."""
    square = tm.linalg.det(c)
    log = 0.5 * tm.log(square)
    return mu / 2 * tm.trace(c) * (1 - square ** (-1 / 3)) - mu * log + lmbda / 2 * log**2


def main():
    """Solve all frames and write them."""
    bar = np.load(HERE / "bar_reference.npz")
    young, poisson = float(bar["young_kPa"]), float(bar["poisson"])
    mu, lmbda = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    mesh = fem.Mesh(bar["nodes_mm"], bar["tets"], "tetra")
    field = fem.FieldContainer([fem.Field(fem.RegionTetra(mesh), dim=3)])
    fixed = np.isin(np.arange(mesh.npoints), bar["fixed_nodes"])
    boundaries = {"fixed": fem.Boundary(field[0], mask=fixed)}
    dof0, dof1 = fem.dof.partition(field, boundaries)
    softened = fem.OgdenRoxburgh(fem.NeoHooke(mu=mu), r=R, m=M_KPA, beta=BETA)
    solid = fem.SolidBody(softened & fem.Hyperelastic(volumetric, mu=mu, lmbda=lmbda), field)
    load = fem.PointLoad(field, np.arange(mesh.npoints), bar["forces_mN"] * 0.0)
    frames = []
    for factor in FACTORS:
        load.update(bar["forces_mN"] * factor)
        fem.newtonraphson(items=[solid, load], dof0=dof0, dof1=dof1, ext0=np.zeros(len(dof0)), tol=1e-11, maxiter=40, verbose=False)
        frames.append(field[0].values.copy())
    np.savez_compressed(
        HERE / "history_reference.npz",
        factors=np.array(FACTORS),
        softening=np.array([R, M_KPA, BETA]),
        displacement_mm=np.array(frames),
    )
    print(np.abs(frames).max(axis=(1, 2)))


if __name__ == "__main__":
    main()
