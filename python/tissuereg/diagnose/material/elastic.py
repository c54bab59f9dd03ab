"""Elastic response to homogeneous deformation: second Piola-Kirchhoff stress and isochoric energy.

Bars with free lateral surfaces are computed by the solver (`tissuereg.material_tests`). In simple shear the whole
tensor is needed, because memory acts on its components. In the plane of shear, with ``det C = 1`` and ``C33 = 1``,

    S = 2 (W1 + I1 W2) I - 2 W2 C - 2/3 (W1 I1 + 2 W2 I2) C^-1        (split laws; no volumetric stress at J = 1)
    S = mu (I - C^-1)                                                  (coupled neo-Hookean law)
"""

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.material import Material
from tissuereg.material_tests import uniaxial_stress


def lame(material: Material) -> tuple[float, float]:
    """Return the Lame constants lambda and mu of a material, kPa."""
    young, poisson = float(material.young_array[0]), float(material.poisson_array[0])
    mu = young / (2.0 * (1.0 + poisson))
    return 2.0 * mu * poisson / (1.0 - 2.0 * poisson), mu


def axial_second_pk(material: Material, stretch: FloatArray) -> FloatArray:
    """Return the axial second Piola-Kirchhoff stress of a bar with free lateral surfaces.

    Parameters
    ----------
    material : Material
        Homogeneous.
    stretch : ndarray of float64, shape (n,)
        Positive.

    Returns
    -------
    ndarray of float64, shape (n,)
        kPa; NaN where the law has no solution.
    """
    return np.asarray(uniaxial_stress(material, stretch) / stretch)


def shear_metric(shear: FloatArray) -> FloatArray:
    """Return ``C`` in the plane of simple shear ``F = I + shear e0 e1``.

    Parameters
    ----------
    shear : ndarray of float64, shape (n,)
        Amounts.

    Returns
    -------
    ndarray of float64, shape (n, 2, 2)
        Determinant 1.
    """
    metric = np.zeros((len(shear), 2, 2))
    metric[:, 0, 0] = 1.0
    metric[:, 0, 1] = metric[:, 1, 0] = shear
    metric[:, 1, 1] = 1.0 + shear**2
    return metric


def plane_second_pk(material: Material, metric: FloatArray) -> FloatArray:
    """Return the second Piola-Kirchhoff stress of an area-preserving plane deformation.

    Parameters
    ----------
    material : Material
        Homogeneous; not of the law hooke.
    metric : ndarray of float64, shape (n, 2, 2)
        ``C`` in the plane, determinant 1.

    Returns
    -------
    ndarray of float64, shape (n, 2, 2)
        kPa, in the plane.
    """
    lmbda, mu = lame(material)
    identity, inverse = np.eye(2), _inverse(metric)
    i1 = metric[:, 0, 0] + metric[:, 1, 1] + 1.0
    if material.law in ("neo-hookean", "bimodular"):
        stress = mu * (identity - inverse)
        if material.law == "bimodular":
            stress = stress + 2.0 * mu * float(material.shape["excess"]) * _stretched(metric)
    elif material.law == "st-venant-kirchhoff":
        strain = 0.5 * (metric - identity)
        trace = strain[:, 0, 0] + strain[:, 1, 1]
        stress = lmbda * trace[:, None, None] * identity + 2.0 * mu * strain
    elif material.law == "ogden":
        stress = _ogden_second_pk(material, mu, metric)
    else:
        w1, w2 = (w[:, None, None] for w in _slopes(material, mu, i1))
        i1 = i1[:, None, None]  # I2 = I1 here
        pressure = 2.0 * w1 + 4.0 * w2 if material.volumetric == "coupled" else 2.0 / 3.0 * (w1 + 2.0 * w2) * i1
        stress = 2.0 * (w1 + i1 * w2) * identity - 2.0 * w2 * metric - pressure * inverse
    if material.fibre is not None:
        stress = stress + _fibre_second_pk(material, mu, metric, inverse)
    return np.asarray(stress)


def isochoric_energy(material: Material, stretches: FloatArray) -> FloatArray:
    """Return the energy density at volume-preserving principal stretches, without fibres.

    Parameters
    ----------
    material : Material
        Homogeneous.
    stretches : ndarray of float64, shape (n, 3)
        Of product 1.

    Returns
    -------
    ndarray of float64, shape (n,)
        kPa.
    """
    _, mu = lame(material)
    shape = material.shape
    i1, i2 = (stretches**2).sum(axis=1) - 3.0, (stretches**-2.0).sum(axis=1) - 3.0
    match material.law:
        case "ogden":
            energy = np.zeros(len(stretches))
            for alpha, share in _ogden_terms(material):
                energy += 2.0 * mu * share / alpha**2 * ((stretches**alpha).sum(axis=1) - 3.0)
            return energy
        case "bimodular":
            stretched = np.maximum(np.log(stretches), 0.0)
            return np.asarray(0.5 * mu * i1 + mu * float(shape["excess"]) * (stretched**2).sum(axis=1))
        case "mooney-rivlin":
            share = float(shape["share"])
            return np.asarray(0.5 * mu * ((1.0 - share) * i1 + share * i2))
        case "yeoh":
            c2, c3 = float(shape["c2_over_c1"]), float(shape["c3_over_c1"])
            return np.asarray(0.5 * mu * (i1 + c2 * i1**2 + c3 * i1**3))
        case "fung" | "veronda-westmann":
            b = float(shape["b"])
            grown = i1 if b == 0 else np.expm1(np.minimum(b * i1, 500.0)) / b
            return np.asarray(0.5 * mu * grown if material.law == "fung" else mu * grown - 0.5 * mu * i2)
        case "st-venant-kirchhoff" | "hooke":
            strain = 0.5 * (stretches**2 - 1.0)
            return np.asarray(mu * (strain**2).sum(axis=1))
    return np.asarray(0.5 * mu * i1)


def _slopes(material: Material, mu: float, i1: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return dW/dI1 and dW/dI2 of the laws in invariants, kPa."""
    shape, a = material.shape, i1 - 3.0
    none = np.zeros(len(a))
    match material.law:
        case "mooney-rivlin":
            share = float(shape["share"])
            return none + 0.5 * mu * (1.0 - share), none + 0.5 * mu * share
        case "yeoh":
            c2, c3 = float(shape["c2_over_c1"]), float(shape["c3_over_c1"])
            return 0.5 * mu * (1.0 + 2.0 * c2 * a + 3.0 * c3 * a**2), none
        case "fung":
            return 0.5 * mu * np.exp(np.minimum(float(shape["b"]) * a, 500.0)), none
    # Veronda and Westmann
    return mu * np.exp(np.minimum(float(shape["b"]) * a, 500.0)), none - 0.5 * mu


def _ogden_terms(material: Material) -> list[tuple[float, float]]:
    alpha, weight = np.atleast_1d(material.shape["alpha"]), np.atleast_1d(material.shape["weight"])
    return [(float(a), float(w)) for a, w in zip(alpha, weight / weight.sum(), strict=True)]


def _larger_square(metric: FloatArray) -> FloatArray:
    """Return the square of the larger principal stretch in the plane; that of the other is its inverse."""
    half = 0.5 * (metric[:, 0, 0] + metric[:, 1, 1])
    return np.asarray(half + np.sqrt(np.maximum(half**2 - 1.0, 0.0)))


def _stretched(metric: FloatArray) -> FloatArray:
    """Return the tensile part of the logarithmic strain in the plane, over the square of the stretch, (n, 2, 2)."""
    larger = _larger_square(metric)
    gap = larger - 1.0 / larger
    along = (metric - (1.0 / larger)[:, None, None] * np.eye(2)) / np.where(gap > 1e-9, gap, 1.0)[:, None, None]
    return np.asarray((0.5 * np.log(larger) / larger)[:, None, None] * along)


def _ogden_second_pk(material: Material, mu: float, metric: FloatArray) -> FloatArray:
    larger = _larger_square(metric)
    squares = np.stack([larger, 1.0 / larger, np.ones(len(larger))], axis=1)
    tau = np.zeros_like(squares)
    for alpha, share in _ogden_terms(material):
        powers = squares ** (0.5 * alpha)
        even = 1.0 if material.volumetric == "coupled" else powers.mean(axis=1, keepdims=True)
        tau += 2.0 * mu * share / alpha * (powers - even)
    principal = tau / squares
    # Isotropic in the plane: S = p I + q C with these principal values.
    gap = squares[:, 0] - squares[:, 1]
    q = np.where(gap > 1e-9, (principal[:, 0] - principal[:, 1]) / np.where(gap > 1e-9, gap, 1.0), 0.0)
    p = principal[:, 0] - q * squares[:, 0]
    return np.asarray(p[:, None, None] * np.eye(2) + q[:, None, None] * metric)


def _fibre_second_pk(material: Material, mu: float, metric: FloatArray, inverse: FloatArray) -> FloatArray:
    assert material.fibre is not None
    fibre = material.fibre
    towards = np.asarray(fibre.direction, dtype=np.float64).reshape(3)
    towards = towards / np.linalg.norm(towards)
    i4 = np.einsum("i,nij,j->n", towards[:2], metric, towards[:2]) + towards[2] ** 2
    e = np.maximum(i4 - 1.0, 0.0) if fibre.tension_only else i4 - 1.0
    slope = fibre.k1_over_mu * mu * e * np.exp(np.minimum(fibre.k2 * e**2, 500.0))
    dyad = np.outer(towards[:2], towards[:2])
    return np.asarray(2.0 * slope[:, None, None] * (dyad - i4[:, None, None] / 3.0 * inverse))


def _inverse(metric: FloatArray) -> FloatArray:
    inverse = np.empty_like(metric)
    inverse[:, 0, 0], inverse[:, 1, 1] = metric[:, 1, 1], metric[:, 0, 0]
    inverse[:, 0, 1] = inverse[:, 1, 0] = -metric[:, 0, 1]
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    return np.asarray(inverse / determinant[:, None, None])
