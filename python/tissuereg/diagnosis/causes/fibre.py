"""Fibre reinforcement: one family of fibres that stiffens the body along one direction."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import exponential, three
from tissuereg.experiment.effects import Effect, Fibre


@dataclass(frozen=True)
class FibreCause(Cause, id="fibre", family="law", discrete=("direction",)):
    """One family of fibres of any direction, which carry tension only."""

    #: Stiffness over the shear modulus at which changes are simulated.
    size: float = 0.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each of 13 directions, lines in a cubic lattice; none where fibres are believed."""
        if bench.experiment.material.fibre is not None:
            return []
        named = ((f"along {' '.join(f'{x:.2f}' for x in way)}", way) for way in _lines())
        return self.simulated(bench, ((name, _effect(self.size, way), {"direction": way}) for name, way in named))

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return three free parameters: the logarithm of the stiffness over the shear modulus, and two rotations.

        These are tangents of the angles between the fibres and those of the hypothesis, about two perpendicular axes.
        """
        along = np.asarray(variant.settings["direction"])
        sides = np.linalg.svd(along[None])[2][1:]

        def direction(x: FloatArray) -> FloatArray:
            turned = along + x[1:] @ sides
            return np.asarray(turned / np.linalg.norm(turned))

        start = float(np.log(self.size * np.clip(amplitudes[0], 0.1, 4.0)))
        return free_parameters(
            [(start, float(np.log(self.size)), 1.2, 0.05), (0.0, 0.0, 0.5, 0.05), (0.0, 0.0, 0.5, 0.05)],
            lambda x, young: (_effect(float(np.exp(x[0])), direction(x)),),
            lambda x, young: {"k1_over_mu": float(np.exp(x[0])), "k2": 1.0, "direction": direction(x).tolist()},
        )

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return fibres along the pull (the x axis) and across it; none for one mode, which a stiffer law fits too."""
        if len(scene.modes) == 1:
            return []

        def fibre(towards: tuple[float, float, float], x: FloatArray) -> Fibre:
            return Fibre(k1_over_mu=exponential(x[0]), k2=exponential(min(x[1], 6.0)), direction=towards)

        ways = {"along the pull": (1.0, 0.0, 0.0), "across the pull": (0.0, 1.0, 0.0)}
        return [curve_form(label, [(0.0, 1.5)] * 2, partial(fibre, way)) for label, way in ways.items()]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `direction` (3,) and `k1_over_mu`."""
        axis = ", ".join(f"{x:.2f}" for x in values["direction"])
        times = f"{values['k1_over_mu']:.2g} times the shear modulus"
        return f"Fibres along ({axis}), of a stiffness k1 of {times}, carry load when they lengthen."


def _effect(size: float, direction: FloatArray) -> Effect:
    return Fibre(k1_over_mu=size, k2=1.0, direction=three(direction))


def _lines() -> list[FloatArray]:
    steps = [np.array(step, np.float64) for step in itertools.product((-1, 0, 1), repeat=3)]
    return [step / np.linalg.norm(step) for step in steps if tuple(step) > (0.0, 0.0, 0.0)]
