"""Elastic causes: other moduli, other laws (stiffening, Mooney-Rivlin, tension-compression asymmetry), fibres."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.material.causes.base import Form, MaterialCause, exponential, form, sigmoid
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.experiment.effects.elastic import Asymmetry, Fibre, Mooney, OtherLaw, Poisson, Stiffening

#: Laws of one rate of stiffening.
BY_RATE = ("fung", "veronda-westmann")

_MOONEY = "mooney-rivlin"


def _ogden(kind: type[OtherLaw], x: FloatArray, largest: float) -> OtherLaw:
    alphas = [_alpha(float(value), largest) for value in (x[:1] if len(x) == 1 else x[:2])]
    first = 1.0 if len(x) == 1 else sigmoid(float(x[2]))
    return kind(law="ogden", alpha=tuple(alphas), weight=(first, 1.0 - first)[: len(alphas)])


def _alpha(value: float, largest: float) -> float:
    """Return an exponent of Ogden's law: `value` within +- `largest`, not zero, where it is a logarithm."""
    value = min(max(value, -largest), largest)
    return value if abs(value) > 1e-3 else 1e-3


def _ogden_forms(kind: type[OtherLaw], settings: MaterialSettings) -> list[Form]:
    largest = settings.largest_alpha
    prior = [(0.0, settings.alpha_spread)]
    two = [(-20.0, 5.0, 0.0), (8.0, -3.0, 0.0), (-10.0, 18.0, 0.0), (1.5, 12.0, 2.0)]
    return [
        form("ogden", prior, [(-20.0,), (-6.0,), (6.0,), (15.0,)], lambda x: _ogden(kind, x, largest)),
        form(
            "ogden-2", [*prior, *prior, (0.0, 1.5)], [(a, b, c) for a, b, c in two], lambda x: _ogden(kind, x, largest)
        ),
    ]


def _stiffening_forms(scene: Scene) -> list[Form]:
    forms = [*(_by_rate(law, scene.invariant) for law in BY_RATE), _by_ratios("yeoh", scene.invariant)]
    # Where pull or push alone was tested an exponent says no more than how the tangent changes.
    return forms if scene.two_sided else [*forms, *_ogden_forms(Stiffening, scene.settings)]


def _by_rate(law: str, invariant: float) -> Form:
    """Return the form of a stiffening law with one positive parameter, its rate of stiffening.

    The prior median of the rate is one that matters at the largest `invariant` (I1 - 3).
    """
    prior = [(math.log(0.5 / invariant), 1.5)]
    return form(law, prior, [], lambda x: Stiffening(law=law, **shape_of(law, exponential(float(x[0])))))


def _by_ratios(law: str, invariant: float) -> Form:
    """Return the form of a law with the ratios of its second and third coefficient to its first, of either sign.

    The ratios are fitted times the largest `invariant` (I1 - 3), and times its square.
    """

    def effect(x: FloatArray) -> Stiffening:
        return Stiffening(law=law, **shape_of(law, float(x[0]) / invariant, float(x[1]) / invariant**2))

    return form(law, [(0.0, 3.0), (0.0, 3.0)], [(0.5, 0.1), (-0.3, 1.0)], effect)


def _mooney_forms(scene: Scene) -> list[Form]:
    # In simple shear both invariants are equal.
    if scene.modes == ("simple-shear",):
        return []
    share = [(-1.5,), (1.5,)]
    return [
        form(_MOONEY, [(0.0, 1.5)], share, lambda x: Mooney(law=_MOONEY, **shape_of(_MOONEY, sigmoid(float(x[0])))))
    ]


def _asymmetry_forms(scene: Scene) -> list[Form]:
    return _ogden_forms(Asymmetry, scene.settings) if scene.two_sided else []


def _stiffening_sentence(table: Mapping[str, Any]) -> str:
    law = f"a law of the kind {table['law']} ({_shape(table)})"
    return f"The modulus changes with strain; the stress follows {law}."


def _asymmetry_sentence(table: Mapping[str, Any]) -> str:
    return (
        "Tension and compression are asymmetric, with different changes of stiffness with strain: "
        f"an Ogden law ({_shape(table)}) fits all modes at once."
    )


def _shape(table: Mapping[str, Any]) -> str:
    def text(value: Any) -> str:
        return f"{value:.3g}" if isinstance(value, float) else ", ".join(f"{v:.3g}" for v in value)

    return "; ".join(f"{key} {text(value)}" for key, value in table.items() if key not in ("id", "law"))


STIFFENING = MaterialCause("stiffening", "law", _stiffening_forms, _stiffening_sentence)
MOONEY = MaterialCause(
    "mooney",
    "law",
    _mooney_forms,
    lambda table: (
        f"The second invariant has a share of {table[main_key(_MOONEY)]:.2g} of the stiffness (Mooney-Rivlin)."
    ),
)
ASYMMETRY = MaterialCause("asymmetry", "law", _asymmetry_forms, _asymmetry_sentence)


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
