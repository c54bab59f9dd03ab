"""Stress and tangent of six laws from felupe, for `tests/laws.rs`.

    python make_laws_felupe.py          # writes laws_felupe.npz

Laws in isochoric invariants stand beside felupe's volumetric energy K/2 (J - 1)^2. Nothing of this
crate takes part. Needs numpy, felupe and tensortrax.
"""

import felupe as fem
import felupe.constitution.tensortrax as mat
import numpy as np

YOUNG, POISSON = 10.0, 0.45
MU = YOUNG / (2 * (1 + POISSON))
LAMBDA = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
BULK = LAMBDA + 2 * MU / 3

models = mat.models.hyperelastic
volumetric = fem.Volumetric(bulk=BULK)


def beside_volumetric(model, **numbers):
    return mat.Hyperelastic(model, **numbers) & volumetric


LAWS = {
    "neo_hookean": fem.NeoHookeCompressible(mu=MU, lmbda=LAMBDA),
    "mooney_rivlin_quadratic": beside_volumetric(models.mooney_rivlin, C10=0.35 * MU, C01=0.15 * MU),
    "yeoh": beside_volumetric(models.yeoh, C10=MU / 2, C20=0.3 * MU / 2, C30=0.05 * MU / 2),
    "ogden": beside_volumetric(models.ogden, mu=[0.75 * MU, 0.25 * MU], alpha=[4.0, -7.0]),
    "st_venant_kirchhoff": mat.Hyperelastic(models.saint_venant_kirchhoff, mu=MU, lmbda=LAMBDA),
    "hooke": fem.LinearElastic(E=YOUNG, nu=POISSON),
}


def main():
    rng = np.random.default_rng(22)
    h = np.array([size * rng.uniform(-1, 1, (3, 3)) for size in (0.05, 0.2, 0.3, 0.35, 0.4)])
    # felupe: tensor axes first, then quadrature points and cells.
    f = np.moveaxis(h + np.eye(3), 0, -1)[..., None]
    arrays = {"h": h}
    for name, law in LAWS.items():
        state = [f, np.zeros((0, 1, 1))]
        stress = np.broadcast_to(law.gradient(state)[0], f.shape)
        tangent = np.broadcast_to(law.hessian(state)[0], (3, 3, *f.shape))
        arrays[f"{name}_stress"] = np.moveaxis(stress[..., 0], -1, 0).copy()
        arrays[f"{name}_tangent"] = np.moveaxis(tangent[..., 0], -1, 0).reshape(len(h), 9, 9).copy()
    np.savez("laws_felupe.npz", **arrays)


if __name__ == "__main__":
    main()
