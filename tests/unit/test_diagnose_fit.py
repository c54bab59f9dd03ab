"""Fits of known causes and their corrections, findings of the modulus, groups."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from support.targets import YOUNG, part, target_of
from tissuereg.diagnosis import candidates
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.candidates import Candidate
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.base import free_parameters
from tissuereg.diagnosis.correction import make_correction
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import FitTarget, FittedCause, at_believed_modulus, fit, near_to
from tissuereg.diagnosis.nuisances import other_forms
from tissuereg.diagnosis.proof import figure_blocks, proof_blocks
from tissuereg.diagnosis.refined import correctable, corrected_fit, recorrected, refined_effects
from tissuereg.diagnosis.screen import UNKNOWN, Screen, Screened
from tissuereg.diagnosis.search import Search, Step, _Bodies, _pinned, modulus_finding
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import (
    ActuatorOffset,
    Latency,
    MarkerSlip,
    Mooney,
    Poisson,
    Relaxation,
    Sliding,
)


def test_a_prediction_does_not_depend_on_what_was_solved_before():
    predictor = target_of(Latency(latency_s=0.1)).bench.predictor
    relaxing, other = [Relaxation(g=(0.3,), tau_s=(0.4,))], [Relaxation(g=(0.9,), tau_s=(0.05,))]
    alone = predictor.predict(relaxing)
    assert predictor.solved(relaxing) is predictor.solved([*relaxing, Latency(latency_s=0.2)])
    # From another start the same equilibria are found to the tolerance alone: the two must be told apart.
    far = predictor.solved(other)
    beside = predictor.predict(relaxing, near=far)
    assert 0.0 < np.abs(beside - alone).max() < 1e-4 * np.abs(alone).max()
    assert np.array_equal(predictor.predict(relaxing), alone)
    assert np.array_equal(predictor.predict(relaxing, near=far), beside)


def of_forms(target, bank, screened, base, cause):
    """Return the likeliest fit of a cause, from its screened hypothesis and the alternatives to it."""
    least, near = base.log_evidence, near_to(target, base)
    return candidates._fit_forms(target, SimpleNamespace(bank=bank), screened, base, cause, least, near)[0]


@pytest.mark.parametrize("form", ["coupled", "log"])
def test_the_form_of_a_law_is_the_one_that_the_data_have(form):
    # Split invariants resemble another Poisson's ratio; without discretisation error the two can be distinguished.
    target = target_of(Mooney(law="mooney-rivlin", share=0.5, volumetric=form), marker_std=1e-4, force_std=0.02)
    bank = {"mooney": list(CAUSES["mooney"].variants(target.bench))}
    screened = Screened(10.0, bank["mooney"][0], np.ones(1))
    base = fit(target, [])
    found = of_forms(target, bank, screened, base, "mooney")
    values, deviations = found.values(0, 1.0)
    assert (values["law"], values["volumetric"]) == ("mooney-rivlin", form)
    assert abs(values["share"] - 0.5) < 4.0 * deviations["share"]
    (effect,) = found.effects(target.bench.young)
    assert effect.volumetric == form


def test_a_fit_finds_modulus_and_causes_within_their_deviations(of_two):
    found = fit(of_two, [part(of_two, "poisson"), part(of_two, "latency")])
    assert abs(found.young(1.0) - YOUNG) < 4.0 * YOUNG * np.sqrt(found.covariance[0, 0])
    for number, (key, true) in enumerate((("poisson", 0.3), ("latency_s", 0.1))):
        values, deviations = found.values(number, 1.0)
        assert abs(values[key] - true) < 4.0 * deviations[key]
        assert deviations[key] < 0.05
    # The residual is noise.
    assert np.sqrt(np.mean(found.residual**2)) == pytest.approx(1.0, abs=0.1)


def test_the_jacobian_of_a_fit_is_that_at_its_end(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    young = found.young(of_two.bench.young)
    for number, step in ((1, 1e-3), (2, 1e-3)):
        ends = []
        for side in (1.0, -1.0):
            x = found.x.copy()
            x[number] += side * step
            effects = [
                e
                for p, mine in zip(parts, found.slices(), strict=True)
                for e in p.free_parameters.effects(x[mine], young)
            ]
            ends.append(of_two.bench.predictor.predict(effects, young=found.young(1.0)))
        slope = (ends[0] - ends[1]) / (2.0 * step)
        assert np.linalg.norm(found.jacobian[number] - slope) < 0.05 * np.linalg.norm(slope)


def test_a_deviation_of_a_nonlinear_parameter_averages_both_sides(of_two):
    found = fit(of_two, [part(of_two, "latency")])
    bent = replace(found.parts[0].free_parameters, values=lambda x, young: {"late": float(np.exp(x[0])), "said": "so"})
    deviation = 0.5
    known = np.diag([0.01, deviation**2])
    mine = replace(found, parts=(replace(found.parts[0], free_parameters=bent),), covariance=known)
    values, deviations = mine.values(0, 10.0)
    up, down = np.exp(deviation) - 1.0, 1.0 - np.exp(-deviation)
    assert deviations["late"] == pytest.approx(values["late"] * np.sqrt(0.5 * (up**2 + down**2)))
    assert set(deviations) == {"late"}


def test_the_discretisation_error_of_a_found_cause_is_corrected(of_two):
    found = fit(of_two, [part(of_two, "poisson"), part(of_two, "latency")])
    bench = of_two.bench
    better = recorrected(of_two, found)
    effects = found.effects(bench.young)
    coarse = bench.predictor.predict(effects)
    assert np.allclose(better.correction.corrected(coarse), refined_effects(bench, effects))
    assert np.allclose(better.correction.corrected(bench.base), bench.base)
    # The tracker has no discretisation error.
    assert recorrected(of_two, fit(of_two, [part(of_two, "latency")])) is of_two


def of_finer_mesh(target, *effects) -> FitTarget:
    """Return the target for noise-free data of the fine mesh, the believed model corrected."""
    bench = target.bench
    correction = make_correction(bench.layout, bench.base, refined_effects(bench, []))
    layout = SignalLayout(bench.experiment)
    layout.measured[:] = refined_effects(bench, effects)
    return replace(target, bench=Bench(bench.experiment, layout), correction=replace(correction, layout=layout))


def test_a_fit_to_data_of_a_finer_mesh_is_right_once_its_own_error_is_corrected(of_two):
    bench = of_two.bench
    target = of_finer_mesh(of_two, Poisson(poisson=0.3))
    layout = target.bench.layout
    found = fit(target, [part(target, "poisson")])
    better, again = corrected_fit(target, found)
    errors = [abs(f.values(0, 1.0)[0]["poisson"] - 0.3) for f in (found, again)]
    assert errors[1] < 0.2 * errors[0]
    assert again.log_evidence > found.log_evidence + 10.0
    # The correction computed at the first fit removes most of the error at the second.
    effects = again.effects(bench.young)
    coarse, fine = bench.predictor.predict(effects), refined_effects(bench, effects)
    there, left = (
        np.linalg.norm((one.correction.corrected(coarse) - fine)[layout.of_markers()]) for one in (target, better)
    )
    assert left < 0.15 * there


def test_an_effect_that_becomes_another_one_is_corrected_again():
    # The slipping region depends on the friction: the discretisation error is no multiple of the effect.
    slips = Sliding(boundary="base", friction=0.1, cohesion_kpa=0.2)
    target = of_finer_mesh(target_of(), slips)
    found = fit(target, [part(target, "sliding", amplitude=1.0, kind="friction")])
    once = recorrected(target, found)
    first = fit(once, found.parts, start=found.x)
    better, again = corrected_fit(target, found)

    def left(corrected, fitted):
        effects, coarse = at_believed_modulus(target, fitted)
        missed = corrected.correction.corrected(coarse) - refined_effects(target.bench, effects)
        return float(np.linalg.norm(target.white(missed)))

    assert left(once, first) > 2.0 * DEFAULT.model.uncorrected
    assert left(better, again) < DEFAULT.model.uncorrected
    # Effects that only change in size need one fine solve.
    calls = []
    fitted = fit(target, [part(target, "poisson")])
    target.bench.progress = calls.append
    corrected_fit(target, fitted)
    assert len(calls) == 1


def test_a_fine_mesh_is_not_solved_for_effects_of_memory(of_two, monkeypatch):
    assert not correctable(of_two, ["poisson", "relaxation"])
    assert not correctable(replace(of_two, bench=remembering(of_two.bench)), ["poisson"])
    assert not correctable(of_two, [])
    assert correctable(of_two, ["poisson"])
    monkeypatch.setattr(import_module("tissuereg.diagnosis.refined"), "refined_effects", lambda *_: pytest.fail("fine"))
    assert recorrected(of_two, SimpleNamespace(ids=("poisson", "relaxation"))) is of_two


def remembering(bench):
    """Return the bench of the same experiment with a believed relaxation."""
    relaxing = Relaxation(g=(0.3,), tau_s=(2.0,))
    return bench.of(replace(bench.experiment, effects=(*bench.experiment.effects, relaxing)))


def test_a_shifted_patch_is_fitted_without_jumps(of_two):
    shifted = part(of_two, "actuator_offset", actuator="top", kind="patch")
    assert shifted.free_parameters.columns.shape == (2, of_two.bench.layout.size)
    found = fit(of_two, [shifted])
    straight = found.x[1:] @ shifted.free_parameters.columns
    forces = ~of_two.bench.layout.of_markers()
    scaled = np.where(forces, found.young(1.0), 1.0)
    assert np.allclose(found.prediction, scaled * (of_two.bench.base + straight))
    effect = shifted.free_parameters.effects(np.array([1.0, 0.0]), 10.0)[0]
    assert isinstance(effect, ActuatorOffset)
    assert np.linalg.norm(effect.shift_mm) == pytest.approx(1.0)


def test_what_differs_in_the_tracker_alone_is_solved_once(of_two, monkeypatch):
    predictor = Bench(of_two.bench.experiment, of_two.bench.layout).predictor
    solved = []
    once = predictor._solve
    monkeypatch.setattr(predictor, "_solve", lambda *given, **how: solved.append(given) or once(*given, **how))
    late = [predictor.predict([Poisson(poisson=0.35), Latency(latency_s=s)]) for s in (0.0, 0.1, 0.2)]
    assert len(solved) == 1
    assert np.abs(late[2] - late[0]).max() > 0.01
    predictor.predict([Poisson(poisson=0.35)], young=1.2)
    assert len(solved) == 2


@pytest.fixture
def of_the_same_mesh(monkeypatch):
    """Data of the user's own mesh have no discretisation error to correct."""
    monkeypatch.setattr(candidates, "corrected_fit", lambda target, found: (target, found))


@pytest.mark.usefixtures("of_the_same_mesh")
def test_a_rival_replaces_a_cause_where_it_is_better(of_two):
    wrong = fit(of_two, [part(of_two, "scale"), part(of_two, "latency")])
    mate = part(of_two, "poisson")
    target, better = candidates.exchanged(of_two, wrong, 0, [(mate, mate.free_parameters.start)])
    assert better.ids == ("poisson", "latency")
    again = part(of_two, "scale")
    assert candidates.exchanged(target, better, 0, [(again, again.free_parameters.start)])[1] is better


def noise_patterns(target):
    """Return a screen whose generic rival has eight patterns of noise, which predict no held-out case."""
    return SimpleNamespace(generic_white=[np.random.default_rng(2).standard_normal((8, target.bench.layout.size))])


def test_a_modulus_far_beyond_its_prior_is_a_finding_that_is_proved():
    target = target_of(young=4.0)
    base = fit(target, [])
    found = modulus_finding(target, noise_patterns(target), Search(base, base))
    assert found.parameters["young_kpa"] == pytest.approx(40.0, rel=0.02)
    assert found.probability > 0.9
    held = found.held_out
    # With its modulus the model leaves noise; the believed one is wrong by more than half of every force.
    assert held["chi_named"] == pytest.approx(1.0, abs=0.1)
    assert held["chi_base"] > 5.0 * held["chi_named"]
    assert held["chi_generic"] > 5.0 * held["chi_named"]
    assert set(held["cases"]) == {"down", "in"}
    # The bench keeps its own prior.
    assert target.bench.young_spread == pytest.approx(0.3)


def test_a_third_of_the_believed_modulus_has_the_same_evidence_as_three_times_of_it():
    for young in (1.0 / 3.0, 3.0):
        target = target_of(young=young)
        base = fit(target, [])
        found = modulus_finding(target, noise_patterns(target), Search(base, base))
        assert found.log_bayes_factor == pytest.approx(0.5 * (np.log(3.0) / 0.3) ** 2, rel=0.05)


@pytest.mark.parametrize("young", [0.45, 1.6, 2.2])
def test_a_modulus_within_three_deviations_of_its_logarithm_is_no_finding(young):
    target = target_of(young=young)
    base = fit(target, [])
    assert modulus_finding(target, noise_patterns(target), Search(base, base)) is None


@pytest.mark.filterwarnings("ignore::tissuereg.errors.LockingWarning")  # the believed modulus wants it incompressible
def test_a_modulus_is_proved_given_the_causes_found_and_their_correction():
    target = target_of(Poisson(poisson=0.3), young=2.6, marker_std=0.001, force_std=0.05)
    base, final = fit(target, []), fit(target, [part(target, "poisson")])
    # The first correction is not that of the model with its causes.
    first = replace(target, correction=replace(target.correction, difference=np.full(target.bench.layout.size, 5.0)))
    found = modulus_finding(first, noise_patterns(target), Search(base, final, target=target))
    assert found.parameters["young_kpa"] == pytest.approx(26.0, rel=0.01)
    # The model with the cause and the believed modulus is fitted as well as possible.
    held = found.held_out
    assert held["chi_named"] == pytest.approx(1.0, abs=0.1)
    pinned = fit(replace(target, bench=_pinned(target.bench)), final.parts)
    again = fit(replace(target, bench=_pinned(target.bench)), final.parts, start=pinned.x)
    # The pin shortens no step: twelve more iterations, of a model that is far off, gain little.
    assert pinned.objective < 1.1 * again.objective


def test_a_modulus_within_its_prior_is_no_finding(of_two):
    base = fit(of_two, [])
    assert modulus_finding(of_two, None, Search(base, base)) is None


def test_a_search_with_withdrawn_findings_has_the_believed_model(of_two):
    base = fit(of_two, [])
    found = fit(of_two, [part(of_two, "poisson")])
    step = Step({}, [], Candidate("poisson", found, 9.0, of_two), None)
    search = Search(base, found, [step, replace(step, found=None)], found.residual).withdrawn(of_two)
    assert search.final is base
    assert [s.found for s in search.steps] == [None, None]
    assert np.allclose(search.reduced, base.residual)


def test_candidates_close_to_the_one_found_are_counted_from_its_own_round():
    candidates = [
        Candidate(name, None, gain, None) for name, gain in (("layer", 30.0), ("fibre", 25.0), ("scale", 10.0))
    ]
    step = Step({}, candidates, candidates[0], None).retested(Candidate("layer", None, 300.0, None))
    assert [c.id for c in step.close(8.0)] == ["fibre"]
    assert replace(step, found=None).close(8.0) == []


def grouped(threshold, named=(), **gains):
    candidates = [Candidate(name, None, gain, None) for name, gain in gains.items()]
    return Step({}, candidates, candidates[0], None).group(threshold, named)


def test_a_group_holds_what_passes_the_threshold_or_is_a_tenth_as_likely():
    # Tempered by two, a tenth as likely is 4.6 nats.
    assert grouped(6.0, mooney=7.9, asymmetry=5.8, layer=3.4, fibre=3.2) == ("mooney", "asymmetry", "layer")
    assert grouped(6.0, latency=20.0, rate=14.0, softening=13.0, layer=11.9) == ("latency", "rate", "softening")
    assert grouped(15.0, latency=20.0, rate=14.0, scale=11.0) == ("latency",)
    # Other findings are no members of a group, and take no member's place.
    found = {"latency", "rate"}
    assert grouped(6.0, found, latency=20.0, rate=14.0, softening=13.0, layer=12.5) == ("latency", "softening", "layer")


def test_a_share_of_every_causes_probability_is_assigned_to_effects_that_look_like_it():
    screened = {name: Screened(gain, None, np.empty(0)) for name, gain in (("layer", 1.0), (UNKNOWN, 0.0))}
    found = Candidate("mooney", None, 300.0, None)
    chances = Step(screened, [found], None, None).chances()
    assert sum(chances.values()) == pytest.approx(1.0)
    assert chances["mooney"] == pytest.approx(1.0 - DEFAULT.evidence.look_alike)
    assert chances[UNKNOWN] == pytest.approx(DEFAULT.evidence.look_alike)


def test_errors_are_stated_for_cases_whose_change_the_others_determine(of_two):
    layout = of_two.bench.layout
    first, second = (layout.of_case(part.name) for part in layout.parts[:2])
    shared, own = np.where(first | second, 5.0, 0.0), np.where(first, 5.0, 0.0)
    # One parameter that both cases determine.
    assert list(figure_blocks(layout, shared[None], shared)) == [part.name for part in layout.parts[:2]]
    # Undetermined parameters with zero columns change neither; a proof requires determined ones.
    idle = np.stack([shared, *np.zeros((2, layout.size))])
    assert len(figure_blocks(layout, idle, shared)) == 2
    assert len(proof_blocks(layout, idle)) > 2
    # A parameter of the first case alone: frames of that case are held out.
    alone = figure_blocks(layout, own[None], own)
    assert len(alone) > 2
    assert not any((mask & ~first).any() for mask in alone.values())
    # One of two parameters is determined by the first case alone, which therefore cannot be held out; the second can.
    otherwise = 20.0 * own * np.resize([1.0, -1.0], layout.size)
    both = figure_blocks(layout, np.stack([shared, otherwise]), shared + otherwise)
    assert list(both) == [layout.parts[1].name]


def test_a_shifted_patch_is_corrected_too():
    # The user's mesh shifts a patch by whole nodes; the fine one cuts it out at its place.
    shift = ActuatorOffset(actuator="side", shift_mm=(0.0, 8.0, 0.0))
    target = target_of(shift)
    column = target.bench.change(shift) / 8.0
    along = free_parameters(
        [(5.0, 0.0, 8.0, 1.0)],
        lambda x, _: (replace(shift, shift_mm=(0.0, float(x[0]), 0.0)),),
        lambda x, _: {"shift_mm": [0.0, float(x[0]), 0.0]},
    )
    found = fit(target, [FittedCause("actuator_offset", replace(along, columns=column[None]))])
    assert found.x[1] == pytest.approx(8.0, abs=0.5)
    better = recorrected(target, found)
    effects, coarse = at_believed_modulus(target, found)
    np.testing.assert_allclose(coarse, target.bench.base + found.x[1] * column)
    np.testing.assert_allclose(better.correction.corrected(coarse), refined_effects(target.bench, effects), atol=1e-6)


def test_a_detachment_grows_without_jumps():
    target = target_of()
    bench = target.bench
    detached = part(target, "detachment", share=0.15)
    answers = []
    logits = np.linspace(-5.0, -1.0, 81)
    for x in logits:
        mixture = detached.free_parameters.mixture(np.array([20.0, x]), bench.young)
        assert sum(weight for weight, _ in mixture) == pytest.approx(1.0)
        assert all(weight >= 0.0 for weight, _ in mixture)
        answers.append(np.sum([weight * bench.predictor.predict(effects) for weight, effects in mixture], axis=0))
    moved = np.linalg.norm(np.array(answers) - bench.base, axis=1)
    assert moved[0] < 0.2 * moved[-1]
    # A node that comes free at once would be a jump of its whole share.
    assert np.abs(np.diff(moved)).max() < 0.15 * moved[-1]
    (effect,) = detached.free_parameters.effects(np.array([20.0, -1.0]), bench.young)
    assert effect.azimuth_deg == 20.0
    assert effect.share == pytest.approx(1.0 / (1.0 + np.e))


def test_a_slip_is_found_to_begin_in_its_own_frame():
    # Screening has four onsets in a case; this is another one.
    slip = MarkerSlip(marker="P2", offset_mm=(0.3, 0.0, -0.2), from_time_s=2.0)
    target = target_of(slip)
    cause = CAUSES["marker_slip"]
    bank = {"marker_slip": list(cause.variants(target.bench))}
    assert 2.0 not in {variant.settings["onset"] for variant in bank["marker_slip"]}
    near = next(v for v in bank["marker_slip"] if (v.settings["marker"], v.settings["onset"]) == ("P2", 1.0))
    base = fit(target, [])
    screened = Screened(10.0, near, np.full(3, 0.3))
    found = of_forms(target, bank, screened, base, "marker_slip")
    values, deviations = found.values(0, 1.0)
    assert (values["marker"], values["from_time_s"]) == ("P2", 2.0)
    np.testing.assert_allclose(values["offset_mm"], slip.offset_mm, atol=4.0 * max(deviations["offset_mm"]))


def test_another_form_of_a_cause_is_no_further_cause():
    rng = np.random.default_rng(0)
    change, unlike = 40.0 * rng.standard_normal((2, 60))
    later = change + 10.0 * rng.standard_normal(60)
    columns = other_forms(np.stack([0.1 * later[None], 0.1 * unlike[None], 0.2 * change[None]]), change)
    covered = Null(columns)
    # The difference between the two forms is expected, another cause's change is not.
    left, other = (
        later * (change @ later) / (later @ later) - change,
        unlike - (unlike @ change) / (change @ change) * change,
    )
    left -= (left @ change) / (change @ change) * change
    assert np.linalg.norm(covered.reduced(left)) < 0.2 * np.linalg.norm(left)
    assert np.linalg.norm(covered.reduced(other)) > 0.9 * np.linalg.norm(other)
    # The size of the cause is fitted; the other forms have a share of it.
    np.testing.assert_allclose(columns @ change, 0.0, atol=1e-6)
    assert 0.1 < np.linalg.norm(columns) / (DEFAULT.nuisances.form_error * np.linalg.norm(change)) < 0.5
    assert other_forms(np.stack([unlike[None]]), change).shape == (0, 60)


def test_the_other_forms_of_a_found_cause_are_nuisances_for_further_causes(of_two):
    noise, layout = of_two.noise, of_two.bench.layout
    bank = {name: list(CAUSES[name].variants(of_two.bench)) for name in ("swelling",)}
    screen = Screen(bank, np.zeros((1, 1, layout.size)), noise, layout, of_two.correction, of_two.null)
    base = fit(of_two, [])
    found = fit(of_two, [part(of_two, "swelling", 1.0)])
    top = Candidate("swelling", found, 10.0, of_two)
    plain, beyond, _ = _Bodies(of_two, screen, base, {}).with_finding(of_two, base, top)
    change = of_two.white(found.prediction - base.prediction)
    expected = other_forms(screen.white_columns("swelling"), change)
    assert len(expected)
    n = len(of_two.null.nuisances)
    np.testing.assert_allclose(plain.null.nuisances[n:], expected)
    np.testing.assert_allclose(beyond.null.nuisances[: n + len(expected)], plain.null.nuisances)
    assert len(beyond.null.nuisances) > n + len(expected)
    # For a second cause the other forms are those of its own change, given the first.
    both = fit(of_two, [*found.parts, part(of_two, "latency")], start=np.append(found.x, 0.1))
    screen = Screen(
        {"latency": list(CAUSES["latency"].variants(of_two.bench))},
        np.zeros((1, 1, layout.size)),
        noise,
        layout,
        of_two.correction,
        of_two.null,
    )
    top = Candidate("latency", both, 10.0, of_two)
    further, _, _ = _Bodies(of_two, screen, base, {}).with_finding(plain, found, top)
    own = of_two.white(both.prediction - found.prediction)
    np.testing.assert_allclose(further.null.nuisances[len(plain.null.nuisances) :] @ own, 0.0, atol=1e-6)
