"""Causes that replace a believed neo-Hookean law by another one: Mooney-Rivlin, asymmetry, stiffening.

The believed neo-Hookean law is coupled: its energy is not split into isochoric and volumetric parts. A coupled law of
another kind contains it as a special case of the shape parameter (it is nested); a split law also changes the
volumetric response, similar to another Poisson's ratio. The bank holds the nested form, the fit tries the split one
too.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.laws import DECLARED, main_key, shape_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import exponential, inner_share, logistic, logit
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.experiment.effects import EFFECTS, Asymmetry, Effect, Mooney, Stiffening
from tissuereg.experiment.effects.elastic import OtherLaw


@dataclass(frozen=True)
class LawCause(Cause, discrete=("law",)):
    """Laws that contain the believed one at a shape parameter of zero; changes are simulated at one or more values."""

    #: Laws and values of the shape parameter at which changes are simulated. Mooney's is the share of the second
    #: invariant in the energy.
    tried: tuple[tuple[str, float], ...]

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return the effect that puts another law in place of the believed one.

        `size`: first shape parameter, dimensionless, 0 for the neo-Hookean law, all others zero; `form` {"coupled",
        "log", "quadratic"}: energy of volume change, as `Material.volumetric`.
        """
        kind = EFFECTS[self.id]
        assert issubclass(kind, OtherLaw)
        return kind(law=law, volumetric=form, **shape_of(law, size))

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each law and shape parameter tried; none unless the believed law is neo-Hookean."""
        tried = [
            (f"{law} {size:g}", self.effect(law, size, form), {"law": law, "size": size, "volumetric": form})
            for form in _forms(bench)[:1]
            for law, size in self.tried
        ]
        return self.simulated(bench, tried)

    def _of_size(
        self, coordinate: tuple[float, float, float, float], variant: Variant, size: Callable[[float], float]
    ) -> FreeParameters:
        """Return one free parameter, of which the shape parameter `size` is a function, in the law of a variant."""
        law, form = str(variant.settings["law"]), str(variant.settings["volumetric"])
        return free_parameters(
            [coordinate],
            lambda x, young: (self.effect(law, size(x[0]), form),),
            lambda x, young: {"law": law, main_key(law): size(x[0]), "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the hypothesis with the same law for each other form of the energy of volume change."""
        return tuple(replace(variant, settings={**variant.settings, "volumetric": form}) for form in _forms(bench)[1:])


def _forms(bench: Bench) -> tuple[str, ...]:
    """Return the energies of volume change that are tried; the first makes the other law contain the believed one."""
    material = bench.experiment.material
    if material.law != "neo-hookean":
        return ()
    return ("quadratic",) if material.volumetric == "quadratic" else ("coupled", "log")


MOONEY = "mooney-rivlin"


@dataclass(frozen=True)
class MooneyCause(LawCause, id="mooney", family="law"):
    """The Mooney-Rivlin law."""

    tried: tuple[tuple[str, float], ...] = ((MOONEY, 0.5),)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logit of the share of the energy that follows the second invariant."""
        return self._of_size((logit(0.5 * float(amplitudes[0])), 0.0, 1.5, 0.1), variant, logistic)

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form: the logit of the share; none in simple shear, where both invariants are equal."""

        def effect(x: FloatArray) -> Mooney:
            return Mooney(law=MOONEY, **shape_of(MOONEY, inner_share(float(x[0]))))

        sheared = scene.modes == ("simple-shear",)
        return [] if sheared else [curve_form(MOONEY, [(0.0, 1.5)], effect, [(-1.5,), (1.5,)])]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted share of the second invariant."""
        return f"A share of {values[main_key(MOONEY)]:.2g} of the energy follows the second invariant (Mooney-Rivlin)."


#: Exponent at which Ogden's law is the neo-Hookean one, and distances from it at which changes are simulated.
EVEN = 2.0


@dataclass(frozen=True)
class AsymmetryCause(LawCause, id="asymmetry", family="law"):
    """Ogden's law with one term, or a bimodular law, whose tension and compression differ at the smallest strain."""

    #: Distances of Ogden's exponent from the even one, excesses of a bimodular law. Ogden's law is stiffer in
    #: compression for negative exponents, in tension for large positive ones.
    tried: tuple[tuple[str, float], ...] = (("ogden", -12.0), ("ogden", 10.0), ("bimodular", -0.4), ("bimodular", 0.7))

    def effect(self, law: str, size: float, form: str) -> Effect:
        """Return a bimodular law of excess `size` in tension, or Ogden's law of the exponent 2 plus `size`."""
        if law == "bimodular":
            return super().effect(law, size, form)
        exponent = EVEN + size
        # Ogden's law has no exponent of zero.
        if abs(exponent) < 0.1:
            exponent = 0.1 if exponent >= 0 else -0.1
        return Asymmetry(law=law, alpha=(exponent,), weight=(1.0,), volumetric=form)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: Ogden's exponent minus 2, or the logarithm of the ratio of a bimodular law."""
        form, law = str(variant.settings["volumetric"]), str(variant.settings["law"])
        start = float(variant.settings["size"]) * min(max(float(amplitudes[0]), 0.1), 2.0)
        if law == "bimodular":
            return self._of_size((np.log1p(start), 0.0, 0.7, 0.05), variant, lambda x: float(np.expm1(x)))
        return free_parameters(
            [(start, 0.0, 12.0, 0.5)],
            lambda x, young: (self.effect(law, float(x[0]), form),),
            lambda x, young: {"law": law, "alpha": [EVEN + float(x[0])], "volumetric": form},
        )

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return the hypotheses of another energy of volume change; none for a bimodular law."""
        return () if variant.settings["law"] == "bimodular" else super().alternatives(bench, variant)

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return Ogden's laws of one and two terms; none unless tension and compression were both tested."""
        return _ogden(Asymmetry, scene.settings) if scene.two_sided else []

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted shape of Ogden's or a bimodular `law`."""
        if values["law"] == "bimodular":
            factor = 1.0 + values[main_key("bimodular")]
            return f"Stretched directions have {factor:.3g} times the stiffness of compressed ones."
        if len(values["alpha"]) > 1:
            return f"Tension and compression differ as in an Ogden law ({_shape_words(values)})."
        exponent = values["alpha"][0]
        side = "compression" if exponent < EVEN else "tension"
        return f"Tension and compression differ as in an Ogden law of exponent {exponent:.3g}, stiffer in {side}."


#: Laws by which a body stiffens with strain, which are tried in material tests, and values of their first shape
#: parameter at which changes of a rig are simulated: exponents of Fung's law (skin has some tens), a ratio of Yeoh's. A
#: law without values is not tried in rigs.
STIFFENING: dict[str, tuple[float, ...]] = {
    "fung": (1.0, 4.0, 16.0),
    "veronda-westmann": (),
    "yeoh": (2.0,),
}


@dataclass(frozen=True)
class StiffeningCause(LawCause, id="stiffening", family="law"):
    """A law that stiffens with strain in place of the neo-Hookean one."""

    #: Largest logarithm of a shape parameter; a strain of 0.1 then multiplies the modulus by some thousands.
    largest: float = 7.0
    tried: tuple[tuple[str, float], ...] = tuple((law, size) for law, sizes in STIFFENING.items() for size in sizes)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return one free parameter: the logarithm of the law's first shape parameter, which is dimensionless."""
        start = np.log(float(variant.settings["size"]) * np.clip(amplitudes[0], 0.1, 3.0))
        return self._of_size((start, np.log(2.0), 1.2, 0.05), variant, lambda x: float(np.exp(min(x, self.largest))))

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return a form of each law that is tried in curves; Ogden's too where pull or push alone was tested."""
        found = [
            (_by_rate if len(DECLARED[law].shape) == 1 else _by_ratios)(law, scene.invariant) for law in STIFFENING
        ]
        # Of pull or push alone an exponent says no more than how the tangent changes.
        return found if scene.two_sided else [*found, *_ogden(Stiffening, scene.settings)]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted shape parameters of the `law`."""
        return f"The modulus changes with strain, as in a law of the kind {values['law']} ({_shape_words(values)})."


def _shape_words(values: Values) -> str:
    def text(value: float | list[float]) -> str:
        return ", ".join(f"{v:.3g}" for v in value) if isinstance(value, list) else f"{value:.3g}"

    # A single term has all the weight.
    left_out = {"id", "law", "volumetric", *(("weight",) if len(values.get("weight", ())) == 1 else ())}
    return "; ".join(f"{key} {text(value)}" for key, value in values.items() if key not in left_out)


def _by_rate(law: str, invariant: float) -> FreeParameters:
    """Return the form of a law with one rate of stiffening; its prior median matters at the `invariant` (I1 - 3)."""
    median = float(np.log(0.5 / invariant))
    return curve_form(law, [(median, 1.5)], lambda x: Stiffening(law=law, **shape_of(law, exponential(float(x[0])))))


def _by_ratios(law: str, invariant: float) -> FreeParameters:
    """Return the form of a law with two ratios of coefficients, of either sign, fitted times powers of `invariant`."""

    def effect(x: FloatArray) -> Stiffening:
        return Stiffening(law=law, **shape_of(law, float(x[0]) / invariant, float(x[1]) / invariant**2))

    return curve_form(law, [(0.0, 3.0), (0.0, 3.0)], effect, [(0.5, 0.1), (-0.3, 1.0)])


def _ogden(kind: type[OtherLaw], settings: MaterialSettings) -> list[FreeParameters]:
    """Return Ogden's laws of one and two terms, as effects of a kind."""
    largest = settings.largest_alpha

    def effect(x: FloatArray) -> OtherLaw:
        # Exponents within +- `largest` and not zero, where the law is a logarithm.
        alphas = [min(max(float(value), -largest), largest) for value in (x[:1] if len(x) == 1 else x[:2])]
        first = 1.0 if len(x) == 1 else inner_share(float(x[2]))
        return kind(
            law="ogden",
            alpha=tuple(alpha if abs(alpha) > 1e-3 else 1e-3 for alpha in alphas),
            weight=(first, 1.0 - first)[: len(alphas)],
        )

    prior = [(0.0, settings.alpha_spread)]
    two = [(-20.0, 5.0, 0.0), (8.0, -3.0, 0.0), (-10.0, 18.0, 0.0), (1.5, 12.0, 2.0)]
    return [
        curve_form("ogden", prior, effect, [(-20.0,), (-6.0,), (6.0,), (15.0,)]),
        curve_form("ogden-2", [*prior, *prior, (0.0, 1.5)], effect, two),
    ]
