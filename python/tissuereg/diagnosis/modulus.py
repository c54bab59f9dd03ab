"""The modulus as a finding: it is fitted in every model, and named where it lies far from its prior mean.

The log Bayes factor is half the square of its distance from the prior mean in prior standard deviations, in the
logarithm of the modulus; like any cause, it must predict held-out data better than the believed value and the generic
rival.
"""

from copy import copy
from dataclasses import replace

import numpy as np

from tissuereg.diagnosis.answer import Finding
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import FitTarget, fit
from tissuereg.diagnosis.proof import held_out_figures
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.search import Search, prove, references_of


def modulus_finding(target: FitTarget, screen: Screen, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies far from its prior mean, the data determine it, and it is proved.

    `found`: the search with the causes found; the modulus is the first parameter of their fit. The proof compares
    predictions of held-out data with those of the model whose modulus is fixed at the believed value. The result is
    None where one of the three fails, where its probability is less than `stated`, and where that model has no
    equilibrium.
    """
    target = found.target or target
    final, bench = found.final, target.bench
    if "stiffness" in bench.settings.left_out:
        return None
    rules, evidence = bench.settings.search, bench.settings.evidence
    excess = float(abs(final.x[0])) / bench.young_spread
    deviation = float(np.sqrt(final.covariance[0, 0]))
    if (
        excess < rules.far_modulus
        or deviation > rules.determined_modulus * bench.young_spread
        or "stiffness" in final.ids
    ):
        return None
    pinned = replace(target, bench=_pinned(bench))
    start = final.x.copy()
    start[0] = 0.0
    before = fit(pinned, final.parts, start=start) or fit(pinned, final.parts)
    believed = fit(pinned, []) if final.parts else before
    if before is None or believed is None:
        return None
    references = references_of(target, screen, believed, before)
    proof = prove(target, references, before, final, None)
    if not proof.proves(rules):
        return None
    young = final.young(bench.young)
    values = {"young_kpa": young}
    chance = float(
        (1.0 - evidence.look_alike) / (1.0 + np.exp(-0.5 * (excess**2 - rules.far_modulus**2) / evidence.temper))
    )
    if chance < rules.stated:
        return None
    figures = prove(target, references, before, final, None, stated=True)
    return Finding(
        id="stiffness",
        group=("stiffness",),
        probability=chance,
        log_bayes_factor=0.5 * excess**2,
        threshold=0.5 * rules.far_modulus**2,
        parameters=values,
        deviations={"young_kpa": young * deviation},
        held_out=held_out_figures(bench.layout, target.noise, proof, figures),
        sentence=CAUSES["stiffness"].sentence(values),
        group_probability=chance,
    )


def _pinned(bench: Bench) -> Bench:
    """Return a copy of the believed model whose modulus is fixed at the believed value; computed results are shared."""
    other = copy(bench)
    other.young_spread = 1e-9  # in the modulus' logarithm: fixed at the believed value
    return other
