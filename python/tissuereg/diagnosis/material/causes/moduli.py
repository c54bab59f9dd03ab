"""Young's modulus and Poisson's ratio other than believed."""

import math

import numpy as np

from tissuereg.diagnosis.material.causes.base import Form, MaterialCause, form, sigmoid
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects.elastic import Poisson

#: Prior standard deviation of the logarithm of the modulus where it is a cause.
WIDE_YOUNG = 1.5


def _stiffness_forms(scene: Scene) -> list[Form]:
    none = np.zeros(0)
    return [Form("young", none, none, ((),), None)]


def _poisson_forms(scene: Scene) -> list[Form]:
    # A bar determines E, shear determines E / (1 + nu).
    if "simple-shear" not in scene.modes or len(scene.modes) < 2:
        return []
    believed = min(max(2.0 * scene.poisson, 0.02), 0.999)
    mean = math.log(believed / (1.0 - believed))
    starts = [(mean - 1.5,), (mean + 1.0,)]
    return [form("poisson", [(mean, 1.5)], starts, lambda x: Poisson(poisson=0.5 * sigmoid(min(float(x[0]), 8.0))))]


STIFFNESS = MaterialCause(
    "stiffness",
    "young",
    _stiffness_forms,
    lambda table: f"The modulus at small strain is {table['young_kpa']:.3g} kPa, far from the believed one.",
    {"young_kpa": "young_kpa"},
)

POISSON = MaterialCause(
    "poisson",
    "poisson",
    _poisson_forms,
    lambda table: (
        f"Poisson's ratio is {table['poisson']:.3g}: at the believed ratio bars and shear give different moduli."
    ),
    {"poisson": "poisson"},
)
