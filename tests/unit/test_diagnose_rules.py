"""Rules of a diagnosis, each tested by its effect on the answer."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from support.rigs import rig
from support.targets import part, target_of
from tissuereg.diagnosis import search as search_module
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.discrepancy import residual_summary
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.findings import possible_of
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.modulus import modulus_finding
from tissuereg.diagnosis.noise import Noise, estimate_noise
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.nulls import Misfit, draw_nulls
from tissuereg.diagnosis.proof import BEFORE, BELIEVED, GENERIC, NAMED, HeldOut, held_out_figures, linear_model
from tissuereg.diagnosis.report.words import ties
from tissuereg.diagnosis.screen import UNKNOWN, Screen, Screened
from tissuereg.diagnosis.search import Search, search
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Latency, MarkerSlip, Poisson


@pytest.fixture(scope="module")
def of_two():
    return target_of(Poisson(poisson=0.3), Latency(latency_s=0.1))


def screen_of(target, names, null=None):
    """Return a screen of some causes and a generic rival that does nothing."""
    bank = {name: list(CAUSES[name].variants(target.bench)) for name in names}
    layout = target.bench.layout
    return Screen(bank, np.zeros((1, 1, layout.size)), target.noise, layout, target.correction, null or target.null)


def test_null_draws_have_the_error_of_another_mesh(of_two):
    layout = of_two.bench.layout
    screen = screen_of(of_two, ("latency",))
    error = np.zeros(layout.size)
    for p in layout.parts:
        p.markers(error)[:] = 0.2
    drawn = draw_nulls(screen, of_two.null, of_two.noise, layout, [error], 0).residuals
    along = of_two.noise.whitened(error, layout)
    length = float(np.linalg.norm(along))
    sizes = np.abs(drawn @ along) / length
    # Each has the norm computed for the mesh, within a factor; noise alone has a norm of one.
    assert sizes.min() > DEFAULT.nuisances.mesh_share * length / DEFAULT.nulls.mesh_spread - 5.0
    assert np.median(sizes) == pytest.approx(DEFAULT.nuisances.mesh_share * length, rel=0.15)
    assert np.abs(draw_nulls(screen, of_two.null, of_two.noise, layout, [], 0).residuals @ along).max() < 6.0 * length


def test_a_discretisation_error_that_resembles_a_cause_raises_its_threshold(of_two):
    layout = of_two.bench.layout
    screen = screen_of(of_two, ("latency", "poisson"))
    like = 2.0 * screen.bank["poisson"][0].columns[0].astype(float)
    plain = draw_nulls(screen, of_two.null, of_two.noise, layout, [], 0).thresholds
    required = draw_nulls(screen, of_two.null, of_two.noise, layout, [like], 0).thresholds
    assert required["poisson"] > 2.0 * plain["poisson"]


def test_noise_that_is_correlated_in_time_is_seen_in_the_rest_case():
    experiment = rig()
    rng = np.random.default_rng(5)
    own = rng.standard_normal((200, 6, 3))
    for frame in range(1, len(own)):
        own[frame] = 0.6 * own[frame - 1] + 0.8 * own[frame]
    rest = replace(
        experiment.cases["rest"], times=np.arange(200.0) - 200.0, markers=experiment.marker_reference + 0.05 * own
    )
    changed = replace(experiment, cases={**experiment.cases, "rest": rest})
    noise = estimate_noise(changed, SignalLayout(changed))
    assert noise.memory == pytest.approx(0.6, abs=0.06)


def test_a_linear_model_passes_through_its_fit(of_two):
    found = fit(of_two, [part(of_two, "poisson"), part(of_two, "latency")])
    model = linear_model(of_two, found)
    away = (found.x - found.mean) / found.deviation
    assert np.linalg.norm(away) > 0.5
    slopes = model.columns[len(of_two.null.nuisances) :]
    # x = 0 is the prior mean; at the parameters of the fit its residual is that of the fit.
    np.testing.assert_allclose(model.residual - away @ slopes, found.residual, atol=1e-9)


def test_a_found_cause_has_a_model_error_when_further_causes_are_tested(of_two):
    bench = of_two.bench
    layout = bench.layout
    change = np.zeros(layout.size)
    for p in layout.parts[1:]:
        p.markers(change)[..., 0] = 1.0
    covariance = effect_nuisances(bench, change)
    for p in layout.parts[1:]:
        spread = np.sqrt((p.markers(covariance)[..., 0] ** 2).sum(axis=0))
        # The change itself, and smooth patterns of the same size together.
        np.testing.assert_allclose(spread, DEFAULT.nuisances.effect_error * np.sqrt(2.0), rtol=0.2)
    assert not layout.parts[0].markers(covariance).any()
    # Another form of the cause differs by a twentieth of its change, which these nuisances explain.
    slope = (layout.reference[:, 0] - layout.reference[:, 0].mean()) / np.ptp(layout.reference[:, 0])
    wrong = np.zeros(layout.size)
    for p in layout.parts[1:]:
        p.markers(wrong)[..., 0] = 0.05 * (1.0 + slope)
    white = of_two.white(wrong)
    assert np.linalg.norm(Null(of_two.white(covariance)).reduced(white)) < 0.3 * np.linalg.norm(white)


def test_figures_give_each_model_its_own_residuals():
    layout = SignalLayout(rig())
    noise = Noise(np.full(6, 0.05), 0.0, 0.0, 0.0, 1.0, 2.0, True)
    sizes = {BEFORE: 4.0, NAMED: 1.0, GENERIC: 2.0, BELIEVED: 8.0}
    left = np.array([np.full(layout.size, sizes[row]) for row in range(4)])
    figures = HeldOut(("down",), np.arange(4.0)[:, None], left)
    said = held_out_figures(layout, noise, figures, figures)
    assert [said[f"chi_{name}"] for name in ("base", "named", "generic")] == [8.0, 1.0, 2.0]
    assert [said[f"rms_{name}_mm"] for name in ("base", "named", "generic")] == pytest.approx([0.4, 0.05, 0.1])
    assert said["log_density_gain"] == NAMED - BEFORE


def test_detectability_is_the_change_that_nuisances_cannot_explain(of_two):
    layout = of_two.bench.layout
    bare = screen_of(of_two, ("poisson",))
    variant = bare.bank["poisson"][0]
    seen = bare.detectability("poisson", variant, np.ones(1))
    white = of_two.white(variant.columns[0].astype(float))
    assert seen == pytest.approx(np.linalg.norm(white), rel=1e-4)
    like = Null(10.0 * white[None])
    hidden = Screen(bare.bank, np.zeros((1, 1, layout.size)), of_two.noise, layout, of_two.correction, like)
    assert hidden.detectability("poisson", variant, np.ones(1)) < 0.11


def test_causes_that_cannot_be_distinguished_are_a_group():
    tied = SimpleNamespace(group=("layer", "fibre"))
    said = ties(SimpleNamespace(findings=(tied,), next_experiment=None))
    assert said.count("<li>") == 2
    assert "layer" in said.lower()
    alone = ties(SimpleNamespace(findings=(SimpleNamespace(group=("layer",)),), next_experiment=None))
    assert "<li>" not in alone


def test_a_cause_that_a_later_one_makes_redundant_is_removed(of_two, monkeypatch):
    # Two rounds find a cause that explains a part, then the one that explains all of it.
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "refined_effects", lambda *_: None)
    target = target_of(Latency(latency_s=0.15))
    screen = screen_of(target, ("latency", "poisson"))
    base = fit(target, [])
    order = iter(("poisson", "latency"))
    rounds = search_module._round

    def misled(target, screen, base, current, thresholds):
        name = next(order, None)
        step = rounds(target, screen, base, current, {"latency": 1e9, "poisson": 1e9})
        if name is None:
            return step
        parts = [*current.parts, part(target, name)]
        found = fit(target, parts, start=np.concatenate([current.x, parts[-1].free_parameters.start]))
        gain = found.log_evidence - current.log_evidence
        candidate = search_module.Candidate(name, found, gain, target)
        return replace(step, candidates=[candidate], found=candidate, proof=None, figures=None)

    monkeypatch.setattr(search_module, "_round", misled)
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0})
    assert found.final.ids == ("latency",)
    assert [step.found.id for step in found.steps if step.found is not None] == ["latency"]
    assert base.parts == ()


def test_the_residual_after_findings_has_a_place_a_time_and_a_nearest_cause():
    slip = MarkerSlip(marker="P3", offset_mm=(0.5, 0.0, 0.0), from_time_s=22.0)
    target = target_of(Latency(latency_s=0.1), slip)
    screen = screen_of(target, ("latency", "marker_slip"))
    base = fit(target, [])
    found = fit(target, [part(target, "latency")])
    left = residual_summary(target.bench.layout, screen, Search(base, found, [], found.residual), Misfit(1e-6, 0.7))
    assert left["p"] == 1e-6
    assert left["where"][0] == "P3"
    assert "case in" in left["when"]
    assert left["looks_like"] == "marker_slip"
    assert "P3" in left["sentence"]
    # A residual may resemble no cause.
    nothing = residual_summary(
        target.bench.layout, screen, Search(base, found, [], 0.0 * found.residual), Misfit(0.001, 0.9)
    )
    assert nothing["looks_like"] == UNKNOWN


def test_the_thresholds_hold_their_false_alarms_on_draws_of_their_own(of_two):
    layout = of_two.bench.layout
    screen = screen_of(of_two, ("latency", "poisson", "scale", "marker_slip", "actuator_gain"))
    error = 2.0 * screen.bank["poisson"][0].columns[0].astype(float)
    for errors in ([], [error]):
        required = draw_nulls(screen, of_two.null, of_two.noise, layout, errors, 0).thresholds
        fresh = screen.many(draw_nulls(screen, of_two.null, of_two.noise, layout, errors, 1).residuals)
        alarms = np.any([fresh[name] > required[name] for name in required], axis=0).mean()
        # Two in a hundred are meant; five are more than three standard deviations of a count in 500 draws beyond that.
        assert alarms < 0.05
        assert min(required.values()) >= 6.0
    # What resembles the error needs its threshold: a quarter of it would be passed by most draws.
    assert (fresh["poisson"] > 0.25 * required["poisson"]).mean() > 0.5


@pytest.mark.parametrize(("share", "named"), [(1.02, True), (0.98, False), (0.3, False)])
def test_a_cause_is_named_above_its_threshold_alone(of_two, monkeypatch, share, named):
    target = target_of(Latency(latency_s=0.15))
    base = fit(target, [])
    found = fit(target, [part(target, "latency")])
    candidate = search_module.Candidate("latency", found, 20.0, target)
    monkeypatch.setattr(search_module, "refitted", lambda *_: [candidate])
    step = search_module._round(target, screen_of(target, ("latency",)), base, base, {"latency": 20.0 / share})
    assert (step.found is not None) == named


def test_a_cause_less_likely_than_not_is_possible_and_not_stated(monkeypatch):
    target = target_of(Latency(latency_s=0.15))
    base = fit(target, [])
    true = search_module.Candidate("latency", fit(target, [part(target, "latency")]), 150.0, target)
    # A rival with more evidence fails the proof, but the data do distinguish the two.
    wrong = search_module.Candidate("scale", fit(target, [part(target, "scale")]), 300.0, target)
    screen = screen_of(target, ("latency", "scale"))
    held = iter((False, True, True))
    monkeypatch.setattr(HeldOut, "proves", lambda proof, rules: next(held))
    target.bench.settings = replace(DEFAULT, search=replace(DEFAULT.search, most_in_group=1))
    monkeypatch.setattr(search_module, "refitted", lambda *_: [wrong, true])
    step = search_module._round(target, screen, base, base, {"latency": 6.0, "scale": 6.0})
    assert step.found is None
    (listed,) = step.possible
    assert (listed.id, listed.log_bayes_factor, listed.threshold) == ("latency", 150.0, 6.0)
    assert listed.probability < 0.5


@pytest.mark.parametrize(("share", "named"), [(0.9, {"latency", "poisson"}), (1.1, {"latency"})])
def test_what_stays_after_a_revision_passes_its_threshold_again(monkeypatch, share, named):
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "refined_effects", lambda *_: None)
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
        screened = screen.of(search_module._as_screened(screen, target, before))
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
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "refined_effects", lambda *_: None)
    order, rounds = iter(names), search_module._round

    def found(target, screen, base, current, thresholds):
        name, nothing = next(order, None), dict.fromkeys(thresholds, 1e9)
        step = rounds(target, screen, base, current, nothing)
        if name is None:
            return step
        parts = [*current.parts, part(target, name)]
        fitted = fit(target, parts, start=np.concatenate([current.x, parts[-1].free_parameters.start]))
        top = search_module.Candidate(name, fitted, fitted.log_evidence - current.log_evidence, target)
        proof = search_module.prove(target, search_module.references_of(target, screen, base, current), current, fitted)
        return replace(step, candidates=[top], found=top, proof=proof, figures=proof)

    monkeypatch.setattr(search_module, "_round", found)
    return screen_of(target, names)


def test_of_two_that_fail_beside_each_other_and_alone_the_first_stays_as_it_was_accepted(monkeypatch):
    target = target_of(Poisson(poisson=0.38), Latency(latency_s=0.15))
    screen = both_found(monkeypatch, target)
    found = search(target, screen, {"latency": 1e9, "poisson": 1e9})
    assert found.final.ids == ("latency",)
    first, *others = found.steps
    assert first.found.gain == pytest.approx(found.final.log_evidence - found.base.log_evidence, rel=0.02)
    assert [step.found for step in others] == [None, None]
    assert [one["id"] for one in possible_of(found)] == ["poisson"]
    # Nothing of the other's error is left in the model.
    own = effect_nuisances(found.target.bench, found.final.prediction - found.base.prediction)
    assert len(found.target.null.nuisances) - len(own) <= DEFAULT.nuisances.most_forms
    null = search_module._null_after(found.target, found.final)
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
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0})
    assert found.final.ids == (("latency",) if stays else ())
    named = ["poisson"] if stays else ["latency", "poisson"]
    assert sorted(one["id"] for one in possible_of(found)) == named
    if not stays:
        assert found.target is None
        # Nuisances for the errors of causes that are not stated would explain a part of the misfit.
        null = search_module._null_after(target, found.base)
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
    kept = search(target, screen, limits)
    assert kept.final.ids == ("latency", "poisson")
    second = next(step for step in kept.steps if step.found is not None and step.found.id == "poisson")
    assert second.found.fit is kept.final
    assert second.found.gain > 0.0
    screen = both_found(monkeypatch, target)
    gone = search(target, screen, {**limits, "poisson": 1e9})
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
        return search_module._judged(target, screen, base, both, alone, 0, step)

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
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0})
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


def test_a_modulus_is_stated_for_its_probability_and_where_it_is_far_and_determined():
    target = target_of(young=4.0)
    base = fit(target, [])
    screen = screen_of(target, ("latency",))

    def found(*, left_out=(), **search):
        target.bench.settings = replace(DEFAULT, search=replace(DEFAULT.search, **search), left_out=left_out)
        return modulus_finding(target, screen, Search(base, base))

    named = found()
    assert named.parameters["young_kpa"] == pytest.approx(40.0, rel=0.02)
    assert 0.9 < named.probability == named.group_probability < 0.96
    assert found(stated=named.probability - 1e-6) is not None
    assert found(stated=named.probability + 1e-6) is None
    far = abs(base.x[0]) / target.bench.young_spread
    assert found(far_modulus=0.9 * far) is not None
    assert found(far_modulus=1.01 * far) is None
    assert found(determined_modulus=1e-6) is None
    assert found(left_out=("stiffness",)) is None


@pytest.mark.parametrize(
    ("gain", "expected", "proved"),
    [
        (4.1, 40.0, True),
        (3.9, 40.0, False),
        (3.0, 8.0, True),
        (2.8, 8.0, False),
        (0.1, 2.0, True),
        (-0.1, 2.0, False),
        (-0.1, -3.0, False),
        (0.1, 0.0, True),
    ],
)
def test_a_proof_asks_for_four_nats_or_what_nine_of_ten_true_causes_would_give(gain, expected, proved):
    # 8 nats expected: a standard deviation of 4, and 8 - 1.282 * 4 are reached by 90 %.
    proof = HeldOut(("case",), np.array([[0.0], [gain], [-9.0], [0.0]]), np.zeros((4, 1)), expected)
    assert proof.proves(DEFAULT.search) is proved
    beaten = replace(proof, log_density=np.array([[0.0], [gain], [gain], [0.0]]))
    assert not beaten.proves(DEFAULT.search)


def test_the_expected_gain_is_that_of_data_that_the_fit_predicts():
    # Hardly any noise: the data are what the right cause predicts.
    target = target_of(Poisson(poisson=0.38), marker_std=0.01, force_std=0.5)
    base, found = fit(target, []), fit(target, [part(target, "poisson")])
    references = search_module.references_of(target, screen_of(target, ("poisson",)), base, base)
    proof = search_module.prove(target, references, base, found)
    density = proof.log_density.sum(axis=1)
    assert proof.expected_gain == pytest.approx(density[NAMED] - density[BEFORE], rel=0.05)
    assert proof.expected_gain > 100.0


def test_a_cause_that_is_exchanged_leads_the_one_that_was_accepted(of_two, monkeypatch):
    worse, better = fit(of_two, [part(of_two, "latency")]), fit(of_two, [part(of_two, "poisson")])
    monkeypatch.setattr(search_module, "exchanged", lambda *_: (of_two, better))
    bodies = search_module._Bodies(of_two, None, None, {})
    step = replace(of_round(), candidates=[])
    found = bodies.exchanged(search_module._FoundCauses(of_two, of_two, worse, (step,), settled=False))
    assert found.fit is better
    assert not found.settled
    assert found.steps[0].lead == better.log_evidence - worse.log_evidence != 0.0
