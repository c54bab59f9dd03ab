"""The search of a body's causes: rounds tested again in the model of all, exchanged, taken out."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from support.targets import part, screen_of, target_of
from tissuereg.diagnosis import search as search_module
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.screen import UNKNOWN, Screened
from tissuereg.diagnosis.search import possible_of, search
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.experiment.effects import Latency, Poisson


@pytest.mark.parametrize(("share", "named"), [(0.9, {"latency", "poisson"}), (1.1, {"latency"})])
def test_what_stays_after_a_revision_passes_its_threshold_again(monkeypatch, share, named):
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "correctable", lambda *_: False)
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = screen_of(target, ("latency", "poisson"))
    base = fit(target, [])
    first = fit(target, [part(target, "latency")])
    both = fit(target, [*first.parts, part(target, "poisson")], start=np.append(first.x, 0.1))
    alone = fit(target, [both.parts[1]])
    gain = both.log_evidence - first.log_evidence
    assert min(gain, both.log_evidence - alone.log_evidence) > 30.0
    limits = {"latency": 6.0, "poisson": share * gain}
    proof = search_module.prove(target, search_module.references_of(target, screen, base, base), base, first)
    steps = []
    for before, found in ((base, first), (first, both)):
        top = search_module.Candidate(found.parts[-1].id, found, 1e3, target)
        screened = screen.of(search_module._Bodies(target, screen, base, limits).left(target, before))
        steps.append(search_module.Step(screened, [top], top, proof, proof))
    alone = search_module._FoundCauses(target, target, first, (steps[0],))
    known = search_module._FoundCauses(target, target, both, tuple(steps), settled=False, first=alone)
    bodies = search_module._Bodies(target, screen, base, limits)
    monkeypatch.setattr(search_module._Bodies, "grown", lambda *_: known)
    found = search_module.selected(bodies, search_module._FoundCauses(target, target, base), 2)
    final, steps = found.fit, found.steps
    assert set(final.ids) == named
    assert {step.found.id for step in steps if step.found is not None} == named
    assert [one.id for step in steps for one in step.possible] == [name for name in ("poisson",) if name not in named]


def null_after(target, current):
    """Return the covariance of noise and nuisances, the parameters of a fit among them."""
    return Null(np.concatenate([target.null.nuisances, target.slopes(current)]))


def of_round(unknown=-50.0, proof=None):
    """Return a round that found a latency, with two rivals and the generic one; all else is made up."""
    candidates = [
        search_module.Candidate(name, None, gain, None)
        for name, gain in (("latency", 60.0), ("scale", 50.0), ("rate", 40.0))
    ]
    screened = {UNKNOWN: Screened(unknown, None, np.empty(0))}
    return search_module.Step(screened, candidates, candidates[0], proof)


def test_an_exchanged_cause_has_the_probability_by_which_it_leads_the_first():
    step = of_round()
    exchanged = replace(step, lead=4.0).retested(search_module.Candidate("scale", None, 30.0, None))
    assert exchanged.evidence() == {"scale": 30.0, "latency": 26.0, "rate": 6.0, UNKNOWN: -84.0}
    # Without the exchange's evidence the cause that came second in its round would be improbable.
    assert exchanged.chances()["scale"] == pytest.approx(0.96 / (1.0 + np.exp(-2.0)), rel=1e-3)
    assert [c.id for c in exchanged.close(4.5)] == ["latency"]
    # The list of what was tried stays that of the round, and a further test moves all causes alike.
    assert exchanged.gains() == step.gains()
    again = exchanged.retested(search_module.Candidate("scale", None, 35.0, None))
    assert again.evidence() == {"scale": 35.0, "latency": 31.0, "rate": 11.0, UNKNOWN: -79.0}


def test_a_retested_cause_has_the_probability_of_its_evidence_in_the_model_of_all():
    close = of_round(unknown=59.0)
    alone = close.probability(6.0)
    # Beside other causes all of the round explain less, and no cause becomes as likely.
    assert close.retested(search_module.Candidate("latency", None, 20.0, None)).probability(6.0) == pytest.approx(
        alone, abs=1e-3
    )
    weak = of_round().retested(search_module.Candidate("latency", None, 1.0, None))
    assert weak.probability(6.0) == pytest.approx(0.96 / (1.0 + np.exp(-0.5)), rel=0.01)
    # The margin of the proof counts from the same evidence.
    proof = HeldOut(("case",), np.array([[0.0], [9.0], [8.0], [0.0]]), np.zeros((4, 1)))
    narrow = replace(close, proof=proof).retested(search_module.Candidate("latency", None, 20.0, None))
    assert narrow.evidence()[UNKNOWN] == 19.0
    assert narrow.probability(6.0) == pytest.approx(alone, abs=1e-3)
    failed = search_module.PossibleCause("latency", 0.3, 1.0, 6.0)
    assert weak.dropped(failed).evidence() == of_round().gains()


def both_found(monkeypatch, target, names=("latency", "poisson")):
    """Let the search find two causes in this order, whatever their evidence, and nothing more."""
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "correctable", lambda *_: False)
    order, rounds = iter(names), search_module._Bodies.round

    def found(bodies, target, current):
        name, nothing = next(order, None), dict.fromkeys(bodies.thresholds, 1e9)
        step = rounds(replace(bodies, thresholds=nothing), target, current)
        if name is None:
            return step
        parts = [*current.parts, part(target, name)]
        fitted = fit(target, parts, start=np.concatenate([current.x, parts[-1].free_parameters.start]))
        top = search_module.Candidate(name, fitted, fitted.log_evidence - current.log_evidence, target)
        references = search_module.references_of(target, bodies.screen, bodies.base, current)
        proof = search_module.prove(target, references, current, fitted)
        return replace(step, candidates=[top], found=top, proof=proof, figures=proof)

    monkeypatch.setattr(search_module._Bodies, "round", found)
    return screen_of(target, names)


def test_of_two_that_fail_beside_each_other_and_alone_the_first_stays_as_it_was_accepted(monkeypatch):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    found = search(target, screen, {"latency": 1e9, "poisson": 1e9}, 3)
    assert found.final.ids == ("latency",)
    first, *others = found.steps
    assert first.found.gain == pytest.approx(found.final.log_evidence - found.base.log_evidence, rel=0.02)
    assert [step.found for step in others] == [None, None]
    assert [one["id"] for one in possible_of(found)] == ["poisson"]
    # Nothing of the other's error is left in the model.
    own = effect_nuisances(found.target.bench, found.final.prediction - found.base.prediction)
    assert len(found.target.null.nuisances) - len(own) <= DEFAULT.nuisances.most_forms
    null = null_after(found.target, found.final)
    np.testing.assert_allclose(found.reduced, null.reduced(found.final.residual))


@pytest.mark.parametrize(("lead", "stays"), [(7.0, True), (9.0, False)])
def test_of_two_that_fail_the_first_does_not_stay_where_the_data_tell_it_from_the_last(monkeypatch, lead, stays):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    own = search_module._Bodies.tested

    def failing(bodies, known):
        known, _ = own(bodies, known)
        if known.settled:
            return known, {}
        gains = dict(zip(known.ids, (20.0, 20.0 + lead) if len(known.ids) > 1 else (1.0,), strict=True))
        steps = iter(gains.items())
        judged = [
            step if step.found is None else replace(step, found=replace(step.found, gain=next(steps)[1]))
            for step in known.steps
        ]
        failed = {
            at: search_module.PossibleCause(name, 0.1, gain, 99.0) for at, (name, gain) in enumerate(gains.items())
        }
        return replace(known, steps=tuple(judged)), failed

    monkeypatch.setattr(search_module._Bodies, "tested", failing)
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0}, 3)
    assert found.final.ids == (("latency",) if stays else ())
    named = ["poisson"] if stays else ["latency", "poisson"]
    assert sorted(one["id"] for one in possible_of(found)) == named
    if not stays:
        assert found.target is None
        # Nuisances for the errors of causes that are not stated would explain a part of the misfit.
        null = null_after(target, found.base)
        np.testing.assert_allclose(found.reduced, null.reduced(found.base.residual))


@pytest.mark.parametrize(
    ("solvable", "first_out"), [((True, False), [0]), ((False, True), [1]), ((False, False), [0, 1])]
)
def test_of_those_that_fail_what_the_others_have_no_equilibrium_without_waits(monkeypatch, solvable, first_out):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    rest = search_module.without
    monkeypatch.setattr(
        search_module, "without", lambda target, fit, part: rest(target, fit, part) if solvable[part] else None
    )
    bodies = search_module._Bodies(target, screen, fit(target, []), {"latency": 1e9, "poisson": 1e9})
    known = search_module._FoundCauses(target, target, bodies.base)
    for _ in range(2):
        known = bodies.grown(known)
    assert [*bodies.tested(known)[1]] == first_out


def test_a_cause_without_which_there_is_no_equilibrium_stays_or_takes_all_with_it(monkeypatch):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    rest = search_module.without
    monkeypatch.setattr(search_module, "without", lambda target, fit, part: None if part else rest(target, fit, part))
    limits = {"latency": 6.0, "poisson": 6.0}
    kept = search(target, screen, limits, 3)
    assert kept.final.ids == ("latency", "poisson")
    second = next(step for step in kept.steps if step.found is not None and step.found.id == "poisson")
    assert second.found.fit is kept.final
    assert second.found.gain > 0.0
    screen = both_found(monkeypatch, target)
    gone = search(target, screen, {**limits, "poisson": 1e9}, 3)
    assert gone.final is gone.base
    assert gone.target is None
    assert [one["id"] for one in possible_of(gone)] == ["poisson"]


def test_the_causes_of_a_round_keep_their_distance_where_its_finding_is_tested_again(monkeypatch):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    base = fit(target, [])
    both = fit(target, [part(target, "latency"), part(target, "poisson")])
    alone = fit(target, [both.parts[1]])
    top = search_module.Candidate("latency", both, 500.0, target)
    proof = HeldOut(("case",), np.array([[0.0], [50.0], [0.0], [0.0]]), np.zeros((4, 1)))

    def judged(lead=0.0):
        step = search_module.Step({}, [top], top, proof, proof, lead=lead)
        known = search_module._FoundCauses(target, target, both)
        return search_module._Bodies(target, screen, base, {}).judged(known, alone, 0, step)

    # It leads the one that was accepted first, which had 500 nats in the round.
    assert judged(5.0).shift == pytest.approx(judged().shift - 5.0)
    assert judged().shift == pytest.approx(both.log_evidence - alone.log_evidence - 500.0)


@pytest.mark.parametrize(("gains", "named"), [((90.0, 40.0), "latency"), ((40.0, 90.0), "poisson")])
def test_of_two_that_fail_the_one_with_less_evidence_is_taken_out_and_the_other_tested_without_it(
    monkeypatch, gains, named
):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    tested, own = [], search_module._Bodies.tested

    def failing(bodies, known):
        tested.append(known.ids)
        known, _ = own(bodies, known)
        failed = {
            part: search_module.PossibleCause(name, 0.1, gain, 6.0)
            for part, (name, gain) in enumerate(zip(known.ids, gains, strict=False))
        }
        return known, failed if len(tested) == 1 else {}

    monkeypatch.setattr(search_module._Bodies, "tested", failing)
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0}, 3)
    assert found.final.ids == (named,)
    assert tested == [("latency", "poisson"), (named,)]
    (step,) = [step for step in found.steps if step.found is not None]
    # Its evidence is that against the believed model now, and nothing of the other one's error is left in the model.
    gain = found.final.log_evidence - fit(found.target, []).log_evidence
    assert step.found.gain == pytest.approx(gain, abs=DEFAULT.fit.least_gain)
    change = found.target.white(found.final.prediction - found.base.prediction)
    own = effect_nuisances(found.target.bench, found.final.prediction - found.base.prediction)
    of_forms = len(found.target.null.nuisances) - len(own)
    assert of_forms <= DEFAULT.nuisances.most_forms
    assert np.abs(found.target.null.nuisances[:of_forms] @ change).max(initial=0.0) < 0.1 * (change @ change)


def test_a_cause_is_stated_for_the_probability_of_its_group():
    tied = of_round(unknown=-50.0, proof=HeldOut(("case",), np.array([[0.0], [9.0], [0.0], [0.0]]), np.zeros((4, 1))))
    tied = replace(tied, candidates=[replace(tied.found, gain=60.0), replace(tied.candidates[1], gain=59.9)])
    assert tied.chances()["latency"] == pytest.approx(0.96 / (1.0 + np.exp(-0.05)), rel=1e-3)
    assert tied.group(6.0) == ("latency", "scale")
    assert tied.probability(6.0) == pytest.approx(0.96)
    assert tied.failed(6.0) is None
    # A rival that is a finding itself is in no group.
    alone = tied.failed(6.0, ("latency", "scale"))
    assert alone.probability == pytest.approx(0.49, abs=0.01)
    assert (alone.log_bayes_factor, alone.threshold) == (60.0, 6.0)
    assert replace(tied, found=replace(tied.found, gain=5.9)).failed(6.0) is not None


def test_a_cause_that_is_exchanged_leads_the_one_that_was_accepted(of_two, monkeypatch):
    worse, better = fit(of_two, [part(of_two, "latency")]), fit(of_two, [part(of_two, "poisson")])
    monkeypatch.setattr(search_module, "exchanged", lambda *_: (of_two, better))
    bodies = search_module._Bodies(of_two, None, None, {})
    step = replace(of_round(), candidates=[])
    found = bodies.exchanged(search_module._FoundCauses(of_two, of_two, worse, (step,), settled=False))
    assert found.fit is better
    assert not found.settled
    assert found.steps[0].lead == better.log_evidence - worse.log_evidence != 0.0
