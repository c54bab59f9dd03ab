"""The catalogue of causes of material tests, in the order in which their effects are applied."""

from tissuereg.diagnosis.material.causes.base import Form, MaterialCause
from tissuereg.diagnosis.material.causes.laws import (
    ASYMMETRY,
    FIBRE,
    MOONEY,
    POISSON,
    STIFFENING,
    STIFFNESS,
)
from tissuereg.diagnosis.material.causes.memory import RATE, RELAXATION, SET, SOFTENING

#: By id.
CAUSES: dict[str, MaterialCause] = {
    cause.id: cause
    for cause in (STIFFNESS, POISSON, STIFFENING, MOONEY, ASYMMETRY, FIBRE, RELAXATION, RATE, SOFTENING, SET)
}

__all__ = ["CAUSES", "Form", "MaterialCause"]
