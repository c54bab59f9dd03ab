"""The findings of a search with groups, probabilities and held-out errors, and the table of all candidates.

A group holds a cause that was found and those that the data cannot distinguish from it. The modulus is fitted in every
model, and named where it lies far from its prior mean. Its log Bayes factor is half the square of its distance from
that, in the logarithm of the modulus and in prior standard deviations; like any cause, it must predict held-out data
better than the believed value and the generic rival.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from tissuereg.diagnosis.answer import Finding, PossibleCause
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import FitTarget, fit
from tissuereg.diagnosis.proof import held_out_figures
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search, Step, prove, references_of


def findings_of(target: FitTarget, screen: Screen, found: Search, thresholds: Mapping[str, float]) -> list[Finding]:
    """Return the findings of a search; the modulus is one of them where it lies beyond its prior.

    `target`: of the first fit; `thresholds`: log Bayes factor required of every cause, nats, by id. The findings lack
    the errors at inner targets, which are added later.
    """
    findings = []
    young = target.bench.young
    rounds = [(step, step.found) for step in found.steps if step.found is not None]
    named = {top.id for _, top in rounds}
    for part, (step, top) in enumerate(rounds):
        # Parameters are those of the model with all causes found.
        values, deviations = found.final.values(part, young)
        chances = step.chances()
        assert step.proof is not None  # found causes were proved
        assert step.figures is not None
        findings.append(
            Finding(
                id=top.id,
                group=step.group(thresholds[top.id], named),
                probability=chances.get(top.id, 0.0),
                log_bayes_factor=top.gain,
                threshold=thresholds[top.id],
                parameters=values,
                deviations=deviations,
                held_out=held_out_figures(target.bench.layout, target.noise, step.proof, step.figures),
                sentence=CAUSES[top.id].sentence(values),
                group_probability=step.probability(thresholds[top.id], named),
            )
        )
    stiff = modulus_finding(target, screen, found)
    return findings if stiff is None else [stiff, *findings]


def possible_of(found: Search) -> tuple[dict[str, Any], ...]:
    """Return the causes that came close to a finding and are none, likeliest first, as plain data for the answer."""
    named = {step.found.id for step in found.steps if step.found is not None}
    best: dict[str, PossibleCause] = {}
    for one in (one for step in found.steps for one in step.possible if one.id not in named):
        if one.id not in best or one.probability > best[one.id].probability:
            best[one.id] = one
    return tuple(asdict(one) for one in sorted(best.values(), key=lambda one: -one.probability))


def candidates_of(screen: Screen, first: Step) -> tuple[dict[str, Any], ...]:
    """Return every cause that was tried in the first round, likeliest first, as plain data for the answer.

    Each entry has ``id``, ``probability``, ``log_bayes_factor`` in nats, and ``detectability``, the norm of the change
    that the cause makes, in noise deviations.
    """
    chances, gains = first.chances(), first.gains()
    rows: list[dict[str, Any]] = []
    for name in [*CAUSES, UNKNOWN]:
        if name in gains:
            best = first.screened[name].best
            seen = screen.detectability(name, best, first.screened[name].amplitudes) if best is not None else 0.0
            numbers = {"log_bayes_factor": gains[name], "detectability": seen}
            rows.append({"id": name, "probability": chances.get(name, 0.0), **numbers})
    return tuple(sorted(rows, key=lambda row: -float(row["log_bayes_factor"])))


def modulus_finding(target: FitTarget, screen: Screen, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies far from its prior mean, the data determine it, and it is proved.

    `found`: the search with the causes found; the modulus is the first parameter of their fit. The proof compares
    predictions of held-out data with those of the model whose modulus is fixed at the believed value. The result is
    None where one of the three fails, where its probability is less than `stated`, and where that model has no
    equilibrium.
    """
    target = found.target or target
    final, bench = found.final, target.bench
    if "stiffness" in (*bench.settings.left_out, *final.ids):
        return None
    rules, evidence = bench.settings.search, bench.settings.evidence
    excess = float(abs(final.x[0])) / bench.young_spread
    deviation = float(np.sqrt(final.covariance[0, 0]))
    if excess < rules.far_modulus or deviation > rules.determined_modulus * bench.young_spread:
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
    odds = np.exp(-0.5 * (excess**2 - rules.far_modulus**2) / evidence.temper)
    chance = float((1.0 - evidence.look_alike) / (1.0 + odds))
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
