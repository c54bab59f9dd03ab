"""Energy and stress of every law from its textbook energy, for `tests/laws.rs`.

    python make_laws.py          # writes laws_reference.npz beside itself

Energies are written in F, J and principal stretches as they stand in textbooks, evaluated in 90
digits; the stress is their central difference with a step of 1e-25, good to 50 digits. Nothing of
this crate takes part. Needs mpmath and numpy.
"""

from pathlib import Path

import numpy as np
from mpmath import eigsy, exp, log, matrix, mp, mpf

mp.dps = 90

YOUNG, POISSON = mpf("10.0"), mpf(0.45)
MU = YOUNG / (2 * (1 + POISSON))
LAMBDA = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
BULK = LAMBDA + 2 * MU / 3


def det(f):
    return (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )


def trace(m):
    return m[0, 0] + m[1, 1] + m[2, 2]


def volumetric(kind, modulus, j):
    return modulus / 2 * (log(j) ** 2 if kind == "log" else (j - 1) ** 2)


def isochoric(f):
    """Return J and the isochoric invariants."""
    j, c = det(f), f.T * f
    i1 = trace(c)
    i2 = (i1**2 - trace(c * c)) / 2
    return j, i1 * j ** (mpf(-2) / 3), i2 * j ** (mpf(-4) / 3)


def neo_hookean(kind):
    def energy(f):
        j = det(f)
        return MU / 2 * (trace(f.T * f) - 3) - MU * log(j) + volumetric(kind, LAMBDA, j)

    return energy


def bimodular(kind, excess=mpf(0.7)):
    base = neo_hookean(kind)

    def energy(f):
        strains = [log(v) / 2 for v in eigsy(f.T * f, eigvals_only=True)]
        return base(f) + MU * excess * sum(e**2 for e in strains if e > 0)

    return energy


def mooney_rivlin(kind, share=mpf(0.3)):
    def energy(f):
        j, i1, i2 = isochoric(f)
        return MU / 2 * ((1 - share) * (i1 - 3) + share * (i2 - 3)) + volumetric(kind, BULK, j)

    return energy


def yeoh(kind, c2=mpf(0.3), c3=mpf(0.05)):
    def energy(f):
        j, i1, _ = isochoric(f)
        c1 = MU / 2
        a = i1 - 3
        return c1 * a + c1 * c2 * a**2 + c1 * c3 * a**3 + volumetric(kind, BULK, j)

    return energy


def ogden(kind, terms=((mpf(4), mpf(1.2)), (mpf(-7), mpf(0.4)))):
    total = sum(weight for _, weight in terms)

    def energy(f):
        j = det(f)
        values = eigsy(f.T * f, eigvals_only=True)
        stretches = [(v ** mpf(0.5)) * j ** (mpf(-1) / 3) for v in values]
        psi = volumetric(kind, BULK, j)
        for alpha, weight in terms:
            mu = MU * weight / total
            psi += 2 * mu / alpha**2 * (sum(s**alpha for s in stretches) - 3)
        return psi

    return energy


def fung(kind, b=mpf(1.5)):
    def energy(f):
        j, i1, _ = isochoric(f)
        return MU / (2 * b) * (exp(b * (i1 - 3)) - 1) + volumetric(kind, BULK, j)

    return energy


def veronda_westmann(kind, b=mpf(1.1)):
    def energy(f):
        j, i1, i2 = isochoric(f)
        c1 = MU / b
        return c1 * (exp(b * (i1 - 3)) - 1) - c1 * b / 2 * (i2 - 3) + volumetric(kind, BULK, j)

    return energy


def coupled(f):
    """Return ln J and the first two invariants of C."""
    j, c = det(f), f.T * f
    i1 = trace(c)
    return log(j), i1, (i1**2 - trace(c * c)) / 2


def mooney_rivlin_coupled(f, share=mpf(0.3)):
    # Bonet and Wood's compressible form: the modulus of ln^2 J makes up for what I2 has of it.
    log_j, i1, i2 = coupled(f)
    c10, c01 = MU * (1 - share) / 2, MU * share / 2
    return c10 * (i1 - 3) + c01 * (i2 - 3) - 2 * (c10 + 2 * c01) * log_j + (LAMBDA / 2 - 2 * c01) * log_j**2


def yeoh_coupled(f, c2=mpf(0.3), c3=mpf(0.05)):
    log_j, i1, _ = coupled(f)
    a = i1 - 3 - 2 * log_j
    return MU / 2 * (a + c2 * a**2 + c3 * a**3) + LAMBDA / 2 * log_j**2


def ogden_coupled(f, terms=((mpf(4), mpf(1.2)), (mpf(-7), mpf(0.4)))):
    total = sum(weight for _, weight in terms)
    stretches = [v ** mpf(0.5) for v in eigsy(f.T * f, eigvals_only=True)]
    log_j = log(det(f))
    psi = LAMBDA / 2 * log_j**2
    for alpha, weight in terms:
        psi += 2 * MU * weight / total / alpha**2 * (sum(s**alpha for s in stretches) - 3 - alpha * log_j)
    return psi


def fung_coupled(f, b=mpf(1.5)):
    log_j, i1, _ = coupled(f)
    return MU / (2 * b) * (exp(b * (i1 - 3 - 2 * log_j)) - 1) + LAMBDA / 2 * log_j**2


def veronda_westmann_coupled(f, b=mpf(1.1)):
    log_j, i1, i2 = coupled(f)
    c1 = MU / b
    first, second = c1 * (exp(b * (i1 - 3 - 2 * log_j)) - 1), c1 * b / 2 * (i2 - 3 - 4 * log_j)
    return first - second + (LAMBDA / 2 + MU) * log_j**2


def quadratic(e):
    return LAMBDA / 2 * trace(e) ** 2 + MU * trace(e * e.T)


def st_venant_kirchhoff(f):
    return quadratic((f.T * f - mp.eye(3)) / 2)


def hooke(f):
    return quadratic((f + f.T) / 2 - mp.eye(3))


def with_fibre(base, tension_only, k1=mpf(2.5) * MU, k2=mpf(0.8), direction=(0.48, 0.6, -0.64)):
    n = matrix([mpf(v) for v in direction])
    n /= mp.norm(n)

    def energy(f):
        stretched = f * n
        strain = det(f) ** (mpf(-2) / 3) * (stretched.T * stretched)[0] - 1
        if tension_only and strain < 0:
            return base(f)
        return base(f) + k1 / (2 * k2) * (exp(k2 * strain**2) - 1)

    return energy


LAWS = {
    "neo_hookean": neo_hookean("log"),
    "neo_hookean_quadratic": neo_hookean("quadratic"),
    "bimodular": bimodular("log"),
    "mooney_rivlin": mooney_rivlin("log"),
    "mooney_rivlin_quadratic": mooney_rivlin("quadratic"),
    "yeoh": yeoh("log"),
    "ogden": ogden("quadratic"),
    "fung": fung("log"),
    "veronda_westmann": veronda_westmann("quadratic"),
    "mooney_rivlin_coupled": mooney_rivlin_coupled,
    "yeoh_coupled": yeoh_coupled,
    "ogden_coupled": ogden_coupled,
    "fung_coupled": fung_coupled,
    "veronda_westmann_coupled": veronda_westmann_coupled,
    "st_venant_kirchhoff": st_venant_kirchhoff,
    "hooke": hooke,
    "neo_hookean_fibre": with_fibre(neo_hookean("log"), tension_only=False),
    "yeoh_fibre": with_fibre(yeoh("quadratic"), tension_only=True),
    "hooke_fibre": with_fibre(hooke, tension_only=True),
}


def gradients():
    """Return displacement gradients of many sizes, (n, 3, 3)."""
    rng = np.random.default_rng(21)
    sizes = [1e-10, 1e-10, 1e-7, 1e-4, 1e-2, 0.1, 0.2, 0.3, 0.3, 0.4]
    return np.array([size * rng.uniform(-1, 1, (3, 3)) for size in sizes])


def stress(energy, f):
    step = mpf(10) ** -25
    p = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            plus, minus = f.copy(), f.copy()
            plus[i, j] += step
            minus[i, j] -= step
            p[i, j] = float((energy(plus) - energy(minus)) / (2 * step))
    return p


def main():
    h = gradients()
    arrays = {"h": h}
    for name, energy in LAWS.items():
        fs = [matrix(one.tolist()) + mp.eye(3) for one in h]
        arrays[f"{name}_energy"] = np.array([float(energy(f)) for f in fs])
        arrays[f"{name}_stress"] = np.array([stress(energy, f) for f in fs])
    np.savez(Path(__file__).with_name("laws_reference.npz"), **arrays)


if __name__ == "__main__":
    main()
