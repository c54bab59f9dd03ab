"""Fibre reinforcement: one direction is stiffer in tension."""

from collections.abc import Mapping
from typing import Any

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.causes.base import Form, MaterialCause, exponential, form
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects.elastic import Fibre

_DIRECTIONS = {"along the pull": (1.0, 0.0, 0.0), "across the pull": (0.0, 1.0, 0.0)}


def _forms(scene: Scene) -> list[Form]:
    # One mode alone cannot distinguish fibres from a stiffer law.
    if len(scene.modes) < 2:
        return []
    return [form(label, [(0.0, 1.5), (0.0, 1.5)], [], _effect(towards)) for label, towards in _DIRECTIONS.items()]


def _effect(towards: tuple[float, float, float]) -> Any:
    def effect(x: FloatArray) -> Fibre:
        k1, k2 = exponential(float(x[0])), exponential(min(float(x[1]), 6.0))
        return Fibre(k1_over_mu=k1, k2=k2, direction=towards)

    return effect


def _sentence(table: Mapping[str, Any]) -> str:
    label = next(label for label, towards in _DIRECTIONS.items() if list(towards) == list(table["direction"]))
    return f"Fibres {label} carry load when they lengthen, with {table['k1_over_mu']:.2g} times the shear modulus."


FIBRE = MaterialCause("fibre", "fibre", _forms, _sentence)
