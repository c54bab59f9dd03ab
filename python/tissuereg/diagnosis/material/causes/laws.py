"""Other elastic laws: stiffening, Mooney-Rivlin, tension-compression asymmetry."""

import math
from collections.abc import Mapping
from typing import Any

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import main_key, shape_of
from tissuereg.diagnosis.material.causes.base import Form, MaterialCause, exponential, form, sigmoid
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects.elastic import Asymmetry, Mooney, OtherLaw, Stiffening

#: Laws of one rate of stiffening.
BY_RATE = ("fung", "veronda-westmann")

_MOONEY = "mooney-rivlin"

#: Spread of Ogden's exponents about 0: rubber has some -5 to 10, brain -20.
_ALPHA = 15.0
_LARGEST_ALPHA = 80.0


def _ogden(kind: type[OtherLaw], x: FloatArray) -> OtherLaw:
    alphas = [_alpha(float(value)) for value in (x[:1] if len(x) == 1 else x[:2])]
    first = 1.0 if len(x) == 1 else sigmoid(float(x[2]))
    return kind(law="ogden", alpha=tuple(alphas), weight=(first, 1.0 - first)[: len(alphas)])


def _alpha(value: float) -> float:
    """Return an exponent within bounds and not zero, where Ogden's law is a logarithm."""
    value = min(max(value, -_LARGEST_ALPHA), _LARGEST_ALPHA)
    return value if abs(value) > 1e-3 else 1e-3


def _ogden_forms(kind: type[OtherLaw]) -> list[Form]:
    prior = [(0.0, _ALPHA)]
    two = [(-20.0, 5.0, 0.0), (8.0, -3.0, 0.0), (-10.0, 18.0, 0.0), (1.5, 12.0, 2.0)]
    return [
        form("ogden", prior, [(-20.0,), (-6.0,), (6.0,), (15.0,)], lambda x: _ogden(kind, x)),
        form("ogden-2", [*prior, *prior, (0.0, 1.5)], [(a, b, c) for a, b, c in two], lambda x: _ogden(kind, x)),
    ]


def _stiffening_forms(scene: Scene) -> list[Form]:
    forms = [*(_by_rate(law, scene.invariant) for law in BY_RATE), _by_ratios("yeoh", scene.invariant)]
    # Where pull or push alone was tested an exponent says no more than how the tangent changes.
    return forms if scene.two_sided else [*forms, *_ogden_forms(Stiffening)]


def _by_rate(law: str, invariant: float) -> Form:
    """Return a law of one positive rate, near one that matters at the largest strain."""
    prior = [(math.log(0.5 / invariant), 1.5)]
    return form(law, prior, [], lambda x: Stiffening(law=law, **shape_of(law, exponential(float(x[0])))))


def _by_ratios(law: str, invariant: float) -> Form:
    """Return a law of ratios of its second and third coefficient to its first, of either sign."""

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
    return _ogden_forms(Asymmetry) if scene.two_sided else []


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
