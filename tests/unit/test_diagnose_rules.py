"""Rules of a diagnosis, each tested by its effect on the answer."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from support.rigs import rig
from support.targets import part, screen_of, target_of
from tissuereg.diagnosis import search as search_module
from tissuereg.diagnosis.advice import residual_summary
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.noise import Noise, estimate_noise
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.nulls import Misfit, draw_nulls
from tissuereg.diagnosis.proof import BEFORE, BELIEVED, GENERIC, NAMED, HeldOut, held_out_figures, linear_model
from tissuereg.diagnosis.report.page import ties
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search, modulus_finding, search
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Latency, MarkerSlip, Poisson


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
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "correctable", lambda *_: False)
    target = target_of(Latency(latency_s=0.15))
    screen = screen_of(target, ("latency", "poisson"))
    base = fit(target, [])
    order = iter(("poisson", "latency"))
    rounds = search_module._Bodies.round

    def misled(bodies, target, current):
        name = next(order, None)
        step = rounds(replace(bodies, thresholds={"latency": 1e9, "poisson": 1e9}), target, current)
        if name is None:
            return step
        parts = [*current.parts, part(target, name)]
        found = fit(target, parts, start=np.concatenate([current.x, parts[-1].free_parameters.start]))
        gain = found.log_evidence - current.log_evidence
        candidate = search_module.Candidate(name, found, gain, target)
        return replace(step, candidates=[candidate], found=candidate, proof=None, figures=None)

    monkeypatch.setattr(search_module._Bodies, "round", misled)
    found = search(target, screen, {"latency": 6.0, "poisson": 6.0}, 3)
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
    limits, screen = {"latency": 20.0 / share}, screen_of(target, ("latency",))
    step = search_module._Bodies(target, screen, base, limits).round(target, base)
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
    step = search_module._Bodies(target, screen, base, {"latency": 6.0, "scale": 6.0}).round(target, base)
    assert step.found is None
    (listed,) = step.possible
    assert (listed.id, listed.log_bayes_factor, listed.threshold) == ("latency", 150.0, 6.0)
    assert listed.probability < 0.5


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
