"""Softening by the first large load: the Mullins effect, or damage."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import exponential
from tissuereg.experiment.effects import Softening


@dataclass(frozen=True)
class SofteningCause(Cause, id="softening", family="memory", discrete=("form",)):
    """Softening by the largest strain energy so far: on reloading only (Mullins), or on first loading too (damage)."""

    #: Values of r, and of m over the modulus, at which changes are simulated.
    size: float = 1.5
    energies: tuple[float, ...] = (0.003, 0.03)
    #: Forms with the fixed value of beta in each.
    forms: tuple[tuple[str, float], ...] = (("ogden-roxburgh", 0.1), ("damage", 0.0))

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return four hypotheses: Mullins effect and damage, each over two energies; none where one is believed."""
        if self.believed(bench):
            return []
        tried = []
        for (form, beta), energy in itertools.product(self.forms, self.energies):
            effect = Softening(r=self.size, m_kpa=energy * bench.young, beta=beta, form=form)
            tried.append((f"{form}, energy {energy:g}", effect, {"form": form, "energy": energy}))
        return self.simulated(bench, tried)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: the logarithms of r - 1 and of m over Young's modulus, both dimensionless."""
        # At most a share of (1 - 1/r) of the stress is lost.
        lost = min((1.0 - 1.0 / self.size) * float(np.clip(amplitudes[0], 0.05, 2.8)), 0.9)
        energy, form = float(variant.settings["energy"]), str(variant.settings["form"])

        def effect(x: FloatArray, young: float) -> tuple[Softening]:
            r, m_kpa = 1.0 + float(np.exp(x[0])), float(np.exp(x[1])) * young
            return (Softening(r=r, m_kpa=m_kpa, beta=dict(self.forms)[form], form=form),)

        loss = 1.0 / (1.0 - lost) - 1.0
        return free_parameters(
            [(np.log(loss), np.log(0.5), 1.0, 0.1), (np.log(energy), np.log(0.01), 1.5, 0.1)], effect
        )

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return one form, the Mullins effect: logarithms of r - 1 and of m in kPa; none without unloading."""
        if not scene.unloaded:
            return []

        def effect(x: FloatArray) -> Softening:
            return Softening(r=1.0 + exponential(float(x[0])), m_kpa=exponential(float(x[1])))

        return [curve_form("ogden-roxburgh", [(0.0, 1.5), (float(np.log(0.3 * scene.peak_energy)), 1.5)], effect)]

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `r` (dimensionless) and its `form`."""
        if values["form"] == "damage":
            return f"Damage softens the material while it is first loaded (r = {values['r']:.2g})."
        return f"The first large load softens the material permanently (Mullins effect, r = {values['r']:.2g})."
