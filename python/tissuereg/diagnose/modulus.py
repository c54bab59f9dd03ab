"""The modulus as a finding: it is always fitted, and named where it lies far beyond its prior."""

from copy import copy
from dataclasses import replace

import numpy as np

from tissuereg.diagnose.answer import Finding
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.chances import LOOK_ALIKE, TEMPER
from tissuereg.diagnose.fit import Target, fit
from tissuereg.diagnose.proof import (
    BEFORE,
    GENERIC,
    NAMED,
    figure_blocks,
    held_out,
    held_out_figures,
    linear_model,
    proof_blocks,
)
from tissuereg.diagnose.screen import Screen
from tissuereg.diagnose.search import Search, rival_columns

#: The modulus is a finding beyond this many prior deviations, where the data tell it to this share of one.
BEYOND, TOLD = 3.0, 0.3

#: Prior deviation, in the modulus' logarithm, of one that stays as believed; so small that it slows no fit.
_PINNED = 1e-9


def modulus_finding(target: Target, screen: Screen, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies beyond its prior, the data tell it, and it is proved.

    Parameters
    ----------
    target : Target
        What was fitted at first.
    screen : Screen
        It has the generic rival.
    found : Search
        With the causes found; their fit has the modulus.

    Returns
    -------
    Finding or None
        Its log Bayes factor is that of a modulus which may be anything against its prior, normal in its logarithm: half
        the square of the prior deviations that it is off, as many for half of the modulus as for twice of it; the proof
        is against the model whose modulus is as believed. None too where the causes find no equilibrium with that.
    """
    target = found.target or target
    final, bench = found.final, target.bench
    excess = float(abs(final.x[0])) / bench.young_spread
    deviation = float(np.sqrt(final.covariance[0, 0]))
    if excess < BEYOND or deviation > TOLD * bench.young_spread or "stiffness" in final.ids:
        return None
    pinned = replace(target, bench=_pinned(bench))
    start = final.x.copy()
    start[0] = 0.0
    before = fit(pinned, final.parts, start=start) or fit(pinned, final.parts)
    believed = fit(pinned, []) if final.parts else before
    if before is None or believed is None:
        return None
    rival = linear_model(target, before, rival_columns(screen, target, before))
    models = [linear_model(target, before), linear_model(target, final), rival, linear_model(target, believed)]
    slopes = target.white(final.jacobian[:1]) * final.deviation[:1, None]
    change = target.white(final.prediction - before.prediction)
    proof = held_out(models, proof_blocks(bench.layout, slopes))
    density = proof.log_density.sum(axis=1)
    if density[NAMED] <= max(density[BEFORE], density[GENERIC]):
        return None
    young = final.young(bench.young)
    values = {"young_kpa": young}
    figures = held_out(models, figure_blocks(bench.layout, slopes, change))
    return Finding(
        id="stiffness",
        group=("stiffness",),
        probability=float((1.0 - LOOK_ALIKE) / (1.0 + np.exp(-0.5 * (excess**2 - BEYOND**2) / TEMPER))),
        log_bayes_factor=0.5 * excess**2,
        threshold=0.5 * BEYOND**2,
        parameters=values,
        deviations={"young_kpa": young * deviation},
        held_out=held_out_figures(bench.layout, target.noise, proof, figures),
        sentence=CAUSES["stiffness"].sentence(values),
    )


def _pinned(bench: Bench) -> Bench:
    """Return the same bench with a modulus that stays as believed; what it has worked out is shared."""
    other = copy(bench)
    other.young_spread = _PINNED
    return other
