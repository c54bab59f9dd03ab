"""A part of a support has come off."""

import itertools
from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant, knobs, logistic, logit
from tissuereg.effects import Detachment

#: Shares of the boundary's area and number of directions that are tried.
SHARES = (0.08, 0.2)
DIRECTIONS = 8


class DetachmentCause(Cause):
    """A rim of a boundary that is free."""

    id: ClassVar[str] = "detachment"
    discrete: ClassVar[tuple[str, ...]] = ("boundary", "azimuth")

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one secant a boundary, direction and share."""
        names = [boundary.name for boundary in bench.experiment.boundaries]
        azimuths = (np.arange(DIRECTIONS) * (360.0 / DIRECTIONS)).tolist()
        tried = list(itertools.product(names, SHARES, azimuths))
        # A boundary too small to lose a node, or so much, changes nothing.
        changes = bench.changes([[Detachment(boundary=b, azimuth_deg=a, share=s)] for b, s, a in tried])
        for (name, share, azimuth), changed in zip(tried, changes, strict=True):
            if changed is not None:
                settings = {"boundary": name, "azimuth": azimuth, "share": share}
                yield Variant(f"{name} {azimuth:.0f} deg {share:g}", changed[None], settings, positive=True)

    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the direction and the logit of the share; steps are wide, for a node is free or not."""
        name, share = str(variant.settings["boundary"]), float(variant.settings["share"])
        azimuth = float(variant.settings["azimuth"])
        start = logit(share * float(np.clip(amplitudes[0], 0.4, 2.5)))

        def effect(x: FloatArray, young: float) -> tuple[Detachment]:
            return (Detachment(boundary=name, azimuth_deg=float(x[0]), share=logistic(x[1])),)

        return knobs(
            [(azimuth, azimuth, 60.0, 10.0), (start, logit(0.15), 1.0, 0.3)],
            effect,
            lambda x, young: {
                "boundary": name,
                "azimuth_deg": float(x[0]),
                "share": logistic(x[1]),
            },
        )

    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""
        share = values["share"]
        return (
            f"About {100 * share:.0f} % of boundary '{values['boundary']}' has come off, "
            f"towards {values['azimuth_deg']:.0f} degrees."
        )
