"""The findings of a search with groups, probabilities and held-out errors, and the table of all candidates.

A group holds a cause that was found and those that the data cannot distinguish from it.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tissuereg.diagnosis.answer import Finding, PossibleCause
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import FitTarget
from tissuereg.diagnosis.modulus import modulus_finding
from tissuereg.diagnosis.proof import held_out_figures
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search, Step


def findings_of(target: FitTarget, screen: Screen, found: Search, thresholds: Mapping[str, float]) -> list[Finding]:
    """Return the findings of a search; the modulus is one of them where it lies beyond its prior.

    `target`: of the first fit; `thresholds`: log Bayes factor required of every cause, nats, by id. The findings lack
    the errors at inner targets, which are added later.
    """
    findings = []
    young = target.bench.young
    named = {step.found.id for step in found.steps if step.found is not None}
    rounds = [step for step in found.steps if step.found is not None]
    for part, step in enumerate(rounds):
        top = step.found
        assert top is not None  # of those steps
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
    return ([stiff] if stiff is not None else []) + findings


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
            rows.append(
                {
                    "id": name,
                    "probability": chances.get(name, 0.0),
                    "log_bayes_factor": gains[name],
                    "detectability": seen,
                }
            )
    return tuple(sorted(rows, key=lambda row: -float(row["log_bayes_factor"])))
