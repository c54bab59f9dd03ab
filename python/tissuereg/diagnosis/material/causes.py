"""The catalogue of causes of material tests: errors of the believed law, each with its forms and its sentence."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import DECLARED, main_key, shape_of
from tissuereg.diagnosis.causes.laws import STIFFENING
from tissuereg.diagnosis.material.data import Scene
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import Asymmetry, Fibre, Mooney, OtherLaw, Poisson, Stiffening
from tissuereg.experiment.effects.history import Rate, Relaxation, Set, Softening

_MOONEY = "mooney-rivlin"
_DIRECTIONS = {"along the pull": (1.0, 0.0, 0.0), "across the pull": (0.0, 1.0, 0.0)}


@dataclass(frozen=True, eq=False)
class Form:
    """One form of a cause: the formula of an effect on the believed model, with n parameters that are fitted.

    `label`: name, for instance ``yeoh``; `mean`, `std` (n,): of the Gaussian prior of the parameters; `starts`: first
    guesses, each of n parameters; `effect`: returns the effect for parameters (n,); None for Young's modulus, which
    every fit varies.
    """

    label: str
    mean: FloatArray
    std: FloatArray
    starts: tuple[tuple[float, ...], ...]
    effect: Callable[[FloatArray], Effect] | None


@dataclass(frozen=True)
class MaterialCause:
    """One cause that a material test can show: an error of the believed law.

    `id`: id of the cause, the same as in the effect's table; `slot`: part of the model that it replaces; causes with
    the same slot exclude each other; `forms`: returns the forms that curves of given ranges can show; none where the
    cause cannot be observed; `sentence`: returns the finding in words, from the effect's table.
    """

    id: str
    slot: str
    forms: Callable[[Scene], list[Form]]
    sentence: Callable[[Mapping[str, Any]], str]


def _form(
    label: str,
    prior: Sequence[tuple[float, float]],
    starts: Sequence[tuple[float, ...]],
    effect: Callable[[FloatArray], Effect],
) -> Form:
    """Return a form from pairs of prior mean and standard deviation; without `starts` the means are the first guess."""
    mean, std = np.array([p[0] for p in prior]), np.array([p[1] for p in prior])
    return Form(label, mean, std, tuple(starts) or (tuple(mean.tolist()),), effect)


def _sigmoid(x: float) -> float:
    """Return the logistic function 1 / (1 + exp(-x)), kept within (0, 1) by a margin of 1e-6."""
    return float(1e-6 + (1.0 - 2e-6) / (1.0 + np.exp(-np.clip(x, -40.0, 40.0))))


def _exponential(x: float) -> float:
    """Return exp(x) with `x` clipped to [-40, 40], so that the result is finite."""
    return float(np.exp(np.clip(x, -40.0, 40.0)))


def _stiffness_forms(_: Scene) -> list[Form]:
    return [Form("young", np.zeros(0), np.zeros(0), ((),), None)]


def _poisson_forms(scene: Scene) -> list[Form]:
    # A bar determines E, shear determines E / (1 + nu).
    if "simple-shear" not in scene.modes or len(scene.modes) < 2:
        return []
    believed = min(max(2.0 * scene.poisson, 0.02), 0.999)
    mean = math.log(believed / (1.0 - believed))
    starts = [(mean - 1.5,), (mean + 1.0,)]
    return [_form("poisson", [(mean, 1.5)], starts, lambda x: Poisson(poisson=0.5 * _sigmoid(min(float(x[0]), 8.0))))]


def _ogden_forms(kind: type[OtherLaw], settings: MaterialSettings) -> list[Form]:
    largest = settings.largest_alpha

    def effect(x: FloatArray) -> OtherLaw:
        # Exponents within +- `largest` and not zero, where the law is a logarithm.
        alphas = [min(max(float(value), -largest), largest) for value in (x[:1] if len(x) == 1 else x[:2])]
        first = 1.0 if len(x) == 1 else _sigmoid(float(x[2]))
        return kind(
            law="ogden",
            alpha=tuple(alpha if abs(alpha) > 1e-3 else 1e-3 for alpha in alphas),
            weight=(first, 1.0 - first)[: len(alphas)],
        )

    prior = [(0.0, settings.alpha_spread)]
    two = [(-20.0, 5.0, 0.0), (8.0, -3.0, 0.0), (-10.0, 18.0, 0.0), (1.5, 12.0, 2.0)]
    return [
        _form("ogden", prior, [(-20.0,), (-6.0,), (6.0,), (15.0,)], effect),
        _form("ogden-2", [*prior, *prior, (0.0, 1.5)], two, effect),
    ]


def _stiffening_forms(scene: Scene) -> list[Form]:
    forms = [(_by_rate if len(DECLARED[law].shape) == 1 else _by_ratios)(law, scene.invariant) for law in STIFFENING]
    # Where pull or push alone was tested an exponent says no more than how the tangent changes.
    return forms if scene.two_sided else [*forms, *_ogden_forms(Stiffening, scene.settings)]


def _by_rate(law: str, invariant: float) -> Form:
    """Return the form of a law with one rate of stiffening; its prior median matters at the `invariant` (I1 - 3)."""
    prior = [(math.log(0.5 / invariant), 1.5)]
    return _form(law, prior, [], lambda x: Stiffening(law=law, **shape_of(law, _exponential(float(x[0])))))


def _by_ratios(law: str, invariant: float) -> Form:
    """Return the form of a law with two ratios of coefficients, of either sign, fitted times powers of `invariant`."""

    def effect(x: FloatArray) -> Stiffening:
        return Stiffening(law=law, **shape_of(law, float(x[0]) / invariant, float(x[1]) / invariant**2))

    return _form(law, [(0.0, 3.0), (0.0, 3.0)], [(0.5, 0.1), (-0.3, 1.0)], effect)


def _mooney_forms(scene: Scene) -> list[Form]:
    # In simple shear both invariants are equal.
    if scene.modes == ("simple-shear",):
        return []

    def effect(x: FloatArray) -> Mooney:
        return Mooney(law=_MOONEY, **shape_of(_MOONEY, _sigmoid(float(x[0]))))

    return [_form(_MOONEY, [(0.0, 1.5)], [(-1.5,), (1.5,)], effect)]


def _asymmetry_forms(scene: Scene) -> list[Form]:
    return _ogden_forms(Asymmetry, scene.settings) if scene.two_sided else []


def _shape(table: Mapping[str, Any]) -> str:
    def text(value: Any) -> str:
        return f"{value:.3g}" if isinstance(value, float) else ", ".join(f"{v:.3g}" for v in value)

    return "; ".join(f"{key} {text(value)}" for key, value in table.items() if key not in ("id", "law"))


def _fibre_forms(scene: Scene) -> list[Form]:
    # One mode alone cannot distinguish fibres from a stiffer law.
    if len(scene.modes) < 2:
        return []

    def along(towards: tuple[float, float, float]) -> Callable[[FloatArray], Fibre]:
        return lambda x: Fibre(
            k1_over_mu=_exponential(float(x[0])), k2=_exponential(min(float(x[1]), 6.0)), direction=towards
        )

    return [_form(label, [(0.0, 1.5), (0.0, 1.5)], [], along(towards)) for label, towards in _DIRECTIONS.items()]


def _fibre_sentence(table: Mapping[str, Any]) -> str:
    label = next(label for label, towards in _DIRECTIONS.items() if list(towards) == list(table["direction"]))
    return f"Fibres {label} carry load when they lengthen, with {table['k1_over_mu']:.2g} times the shear modulus."


def _relaxation_forms(scene: Scene) -> list[Form]:
    if not (scene.timed and scene.paced and scene.longest_s > scene.shortest_s):
        return []
    low, high = math.log(scene.shortest_s), math.log(scene.longest_s)
    forms = []
    for n in range(1, scene.settings.most_terms + 1):
        # Prior means of the time constants are spread evenly over the decades that the test resolves.
        times = low + (high - low) * (np.arange(n) + 0.5) / n
        spread = (high - low) / (2.0 * n) + 0.3
        prior = [(-0.7, 1.5)] * n + [(float(t), spread) for t in times]
        forms.append(_form(f"prony-{n}", prior, [], _relaxation))
    return forms


def _relaxation(x: FloatArray) -> Relaxation:
    n = len(x) // 2
    shares = np.exp(np.clip(x[:n], -30.0, 30.0))
    shares = np.maximum(shares / (1.0 + shares.sum()), 1e-12)
    times = np.exp(np.clip(x[n:], -30.0, 30.0))
    order = np.argsort(times)
    return Relaxation(g=tuple(shares[order].tolist()), tau_s=tuple(times[order].tolist()))


def _relaxation_sentence(table: Mapping[str, Any]) -> str:
    terms = ", ".join(f"{g:.0%} within {tau:.3g} s" for g, tau in zip(table["g"], table["tau_s"], strict=True))
    return f"The stress relaxes: of the instantaneous stress {terms}."


def _rate_forms(scene: Scene) -> list[Form]:
    if not (scene.timed and scene.paced and scene.fastest > 0):
        return []
    likely = math.log(0.1 * scene.peak / (3.0 * scene.fastest))
    return [_form("viscosity", [(likely, 2.0)], [], lambda x: Rate(viscosity_kpa_s=_exponential(float(x[0]))))]


def _softening_forms(scene: Scene) -> list[Form]:
    if not scene.unloaded:
        return []
    likely = math.log(0.3 * scene.peak_energy)

    def effect(x: FloatArray) -> Softening:
        return Softening(r=1.0 + _exponential(float(x[0])), m_kpa=_exponential(float(x[1])))

    return [_form("ogden-roxburgh", [(0.0, 1.5), (likely, 1.5)], [], effect)]


def _set_forms(scene: Scene) -> list[Form]:
    return [_form("set", [(-2.5, 1.2)], [], lambda x: Set(fraction=_sigmoid(float(x[0]))))] if scene.unloaded else []


#: By id, in the order in which their effects are applied.
CAUSES: dict[str, MaterialCause] = {
    cause.id: cause
    for cause in (
        MaterialCause(
            "stiffness",
            "young",
            _stiffness_forms,
            lambda t: f"The modulus at small strain is {t['young_kpa']:.3g} kPa, far from the believed one.",
        ),
        MaterialCause(
            "poisson",
            "poisson",
            _poisson_forms,
            lambda t: (
                f"Poisson's ratio is {t['poisson']:.3g}: at the believed ratio bars and shear give different moduli."
            ),
        ),
        MaterialCause(
            "stiffening",
            "law",
            _stiffening_forms,
            lambda t: (
                f"The modulus changes with strain; the stress follows a law of the kind {t['law']} ({_shape(t)})."
            ),
        ),
        MaterialCause(
            "mooney",
            "law",
            _mooney_forms,
            lambda t: (
                f"The second invariant has a share of {t[main_key(_MOONEY)]:.2g} of the stiffness (Mooney-Rivlin)."
            ),
        ),
        MaterialCause(
            "asymmetry",
            "law",
            _asymmetry_forms,
            lambda t: (
                "Tension and compression are asymmetric, with different changes of stiffness with strain: "
                f"an Ogden law ({_shape(t)}) fits all modes at once."
            ),
        ),
        MaterialCause("fibre", "fibre", _fibre_forms, _fibre_sentence),
        MaterialCause("relaxation", "relaxation", _relaxation_forms, _relaxation_sentence),
        MaterialCause(
            "rate",
            "rate",
            _rate_forms,
            lambda t: f"The stress grows with the rate of strain: a viscosity of {t['viscosity_kpa_s']:.3g} kPa s.",
        ),
        MaterialCause(
            "softening",
            "softening",
            _softening_forms,
            lambda t: f"Below the largest load so far the material is softer (Mullins effect, r = {t['r']:.3g}).",
        ),
        MaterialCause(
            "set",
            "set",
            _set_forms,
            lambda t: f"A share of {t['fraction']:.2g} of the largest strain so far remains after unloading.",
        ),
    )
}
