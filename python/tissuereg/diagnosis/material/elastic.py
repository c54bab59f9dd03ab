"""Elastic response to homogeneous deformation: second Piola-Kirchhoff stress and isochoric energy.

All of them are computed by the solver's own law at a point. Bars with free lateral surfaces use
`tissuereg.experiment.material_tests`; plane deformations, whose whole tensor is needed because memory acts on its
parts, use the first Piola-Kirchhoff stress at ``F = C^(1/2)``.
"""

from dataclasses import replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.material import Material
from tissuereg.experiment.material_tests import uniaxial_stress


def axial_second_pk(material: Material, stretch: FloatArray) -> FloatArray:
    """Return the axial second Piola-Kirchhoff stress of a bar with free lateral surfaces, shape (n,), in kPa.

    `material`: homogeneous; `stretch` (n,): positive. The stress is NaN where the law has no solution.
    """
    return np.asarray(uniaxial_stress(material, stretch) / stretch)


def shear_metric(shear: FloatArray) -> FloatArray:
    """Return the right Cauchy-Green tensor in the plane of simple shear ``F = I + shear e0 e1``, shape (n, 2, 2).

    `shear` (n,): amounts of shear. The tensors have the determinant 1.
    """
    metric = np.zeros((len(shear), 2, 2))
    metric[:, 0, 0] = 1.0
    metric[:, 0, 1] = metric[:, 1, 0] = shear
    metric[:, 1, 1] = 1.0 + shear**2
    return metric


def plane_second_pk(material: Material, metric: FloatArray) -> FloatArray:
    """Return the in-plane second Piola-Kirchhoff stress of an area-preserving plane deformation, (n, 2, 2), kPa.

    `material`: homogeneous; not of the law hooke; `metric` (n, 2, 2): right Cauchy-Green tensor in the plane, of
    determinant 1.
    """
    identity = np.eye(2)
    # The root of a matrix of determinant 1.
    stretch = (metric + identity) / np.sqrt(metric[:, 0, 0] + metric[:, 1, 1] + 2.0)[:, None, None]
    gradients = np.zeros((len(metric), 3, 3))
    gradients[:, :2, :2] = stretch - identity
    _, stress = material.core_law().response(gradients, *_moduli(material))
    return np.asarray(_inverse(stretch) @ stress[:, :2, :2])


def isochoric_energy(material: Material, stretches: FloatArray) -> FloatArray:
    """Return the energy density at volume-preserving principal stretches, shape (n,), in kPa, without fibres.

    `material`: homogeneous; `stretches` (n, 3): principal stretches of product 1.
    """
    young, poisson = _moduli(material)
    # Without a lambda, St. Venant and Kirchhoff's energy is that of the change of shape; Hooke's is taken for it.
    law = "st-venant-kirchhoff" if material.law == "hooke" else material.law
    gradients = np.zeros((len(stretches), 3, 3))
    gradients[:, range(3), range(3)] = stretches - 1.0
    plain = replace(material, law=law, fibre=None)
    return plain.core_law().response(gradients, young / (1.0 + poisson), 0.0)[0]


def _moduli(material: Material) -> tuple[float, float]:
    return float(material.young_array[0]), float(material.poisson_array[0])


def _inverse(metric: FloatArray) -> FloatArray:
    inverse = np.empty_like(metric)
    inverse[:, 0, 0], inverse[:, 1, 1] = metric[:, 1, 1], metric[:, 0, 0]
    inverse[:, 0, 1] = inverse[:, 1, 0] = -metric[:, 0, 1]
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    return np.asarray(inverse / determinant[:, None, None])
