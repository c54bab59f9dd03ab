"""The first large load softens the body for good."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs
from tissuereg.effects import Softening

#: Where secants are taken: r, and m over the modulus.
SIZE = 1.5
ENERGIES = (0.003, 0.03)

#: Beta of Ogden and Roxburgh, kept.
BETA = 0.1


class SofteningCause(Cause):
    """Ogden and Roxburgh's softening by the largest energy so far."""

    id: ClassVar[str] = "softening"

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return secants for two energies."""
        if any(effect.id == self.id for effect in bench.experiment.effects):
            return
        tried = [[Softening(r=SIZE, m_kpa=energy * bench.young, beta=BETA)] for energy in ENERGIES]
        for energy, changed in zip(ENERGIES, bench.changes(tried), strict=True):
            if changed is not None:
                yield Variant(f"energy {energy:g}", changed[None], {"energy": energy}, positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return logarithms of r - 1 and of m over the modulus."""
        # A share of (1 - 1/r) of the stress goes at most.
        lost = min((1.0 - 1.0 / SIZE) * float(np.clip(amplitudes[0], 0.05, 2.8)), 0.9)
        energy = float(variant.settings["energy"])

        def effect(x: FloatArray, young: float) -> tuple[Softening]:
            return (Softening(r=1.0 + float(np.exp(x[0])), m_kpa=float(np.exp(x[1])) * young, beta=BETA),)

        return knobs(
            [
                (float(np.log(1.0 / (1.0 - lost) - 1.0)), float(np.log(0.5)), 1.0, 0.1),
                (float(np.log(energy)), float(np.log(0.01)), 1.5, 0.1),
            ],
            effect,
            lambda x, young: {
                "r": 1.0 + float(np.exp(x[0])),
                "m_kpa": float(np.exp(x[1])) * young,
                "beta": BETA,
            },
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        return f"The first large load softens the body for good (Mullins effect, r = {values['r']:.2g})."
