"""Softening by the first large load: the Mullins effect, or damage."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Softening


@dataclass(frozen=True)
class SofteningCause(Cause):
    """Softening by the largest strain energy so far: on reloading only (Mullins), or on first loading too (damage)."""

    id: ClassVar[str] = "softening"
    family: ClassVar[str] = "memory"
    discrete: ClassVar[tuple[str, ...]] = ("form",)

    #: Values of r, and of m over the modulus, at which changes are simulated.
    size: float = 1.5
    energies: tuple[float, ...] = (0.003, 0.03)
    #: Forms with the fixed value of beta in each.
    forms: tuple[tuple[str, float], ...] = (("ogden-roxburgh", 0.1), ("damage", 0.0))

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return four hypotheses: Mullins effect and damage, each over two energies; none where one is believed.

        `bench`: the simulation as believed. Columns of a hypothesis, shape (1, size), are the change of all `size`
        measured numbers (markers in mm, forces in mN) by that softening, which acts on reloading only (Mullins) or on
        first loading too (damage).
        """
        if any(effect.id == self.id for effect in bench.experiment.effects):
            return
        betas = dict(self.forms)
        every = [(form, energy) for form in betas for energy in self.energies]
        tried = [
            [Softening(r=self.size, m_kpa=energy * bench.young, beta=betas[form], form=form)] for form, energy in every
        ]
        for (form, energy), changed in zip(every, bench.changes(tried), strict=True):
            if changed is not None:
                settings = {"form": form, "energy": energy}
                yield Variant(f"{form}, energy {energy:g}", changed[None], settings, positive=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: the logarithms of r - 1 and of m over Young's modulus, both dimensionless.

        The body loses at most the share 1/r of the stress (damage: 1 - 1/r), over an energy density of about m (kPa).
        `bench`: the simulation as believed; `variant`: hypothesis that starts the fit; `amplitudes` (1,): its fitted
        amplitudes, in prior standard deviations. The result has first guess, prior, step and effect of each parameter.
        """
        betas = dict(self.forms)
        # At most a share of (1 - 1/r) of the stress is lost.
        lost = min((1.0 - 1.0 / self.size) * float(np.clip(amplitudes[0], 0.05, 2.8)), 0.9)
        energy, form = float(variant.settings["energy"]), str(variant.settings["form"])

        def effect(x: FloatArray, young: float) -> tuple[Softening]:
            r, m_kpa = 1.0 + float(np.exp(x[0])), float(np.exp(x[1])) * young
            return (Softening(r=r, m_kpa=m_kpa, beta=betas[form], form=form),)

        return free_parameters(
            [
                (float(np.log(1.0 / (1.0 - lost) - 1.0)), float(np.log(0.5)), 1.0, 0.1),
                (float(np.log(energy)), float(np.log(0.01)), 1.5, 0.1),
            ],
            effect,
            lambda x, young: {
                "r": 1.0 + float(np.exp(x[0])),
                "m_kpa": float(np.exp(x[1])) * young,
                "beta": betas[form],
                "form": form,
            },
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `r` (dimensionless) and its `form`."""
        if values["form"] == "damage":
            return f"The body is damaged and softens while it is first loaded (r = {values['r']:.2g})."
        return f"The first large load softens the body permanently (Mullins effect, r = {values['r']:.2g})."
