"""Where nonlinear fits begin, what they take from similar ones, and when they are given up."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from support.targets import part, target_of
from tissuereg.diagnosis import candidates
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import FittedCause, Near, best_start, fit, near_to
from tissuereg.diagnosis.screen import Screened
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.errors import ConvergenceError
from tissuereg.experiment.effects import Detachment, Relaxation


def refitted(monkeypatch, cause, seen, fits, corrected_fit, *, least=None, corrects=True):
    """Return the candidate from a cause's fits, given a believed model of -100 nats and a threshold of six."""
    seen_least = [] if least is None else least
    monkeypatch.setattr(candidates, "_fit_forms", lambda *given: (seen_least.append(given[5]), fits)[1])
    monkeypatch.setattr(candidates, "corrected_fit", corrected_fit)
    monkeypatch.setattr(candidates, "near_to", lambda *_: None)
    monkeypatch.setattr(candidates, "correctable", lambda *_: corrects)
    believed = SimpleNamespace(ids=(), parts=(), log_evidence=-100.0)
    own = SimpleNamespace(
        bench=SimpleNamespace(
            settings=DEFAULT, progress=lambda _: None, side_by_side=lambda work, tried: [work(one) for one in tried]
        )
    )
    (found,) = candidates.refitted(own, None, {cause: Screened(seen, None, np.empty(0))}, believed, {cause: 6.0})
    return found


def test_of_several_forms_the_likeliest_after_correction_is_taken(monkeypatch):
    coarse = [SimpleNamespace(form="log", log_evidence=-10.0), SimpleNamespace(form="coupled", log_evidence=-17.0)]
    right = {"log": SimpleNamespace(log_evidence=-32.0), "coupled": SimpleNamespace(log_evidence=-2.0)}
    found = refitted(monkeypatch, "mooney", 70.0, coarse, lambda _, fitted: (fitted.form, right[fitted.form]))
    assert (found.target, found.fit, found.gain) == ("coupled", right["coupled"], 98.0)


@pytest.mark.parametrize(("corrects", "gain"), [(True, DEFAULT.model.correction_gain), (False, 0.0)])
def test_a_fit_goes_on_while_it_may_be_in_a_group_or_gain_by_its_correction(monkeypatch, corrects, gain):
    least, only = [], [SimpleNamespace(log_evidence=-50.0)]
    refitted(monkeypatch, "mooney", 70.0, only, lambda target, fitted: (target, fitted), least=least, corrects=corrects)
    # The believed model has -100 nats, six are required, and a tenth of the probability makes a rival.
    assert least == [pytest.approx(-100.0 + 6.0 - 2.0 * np.log(10.0) - gain)]


@pytest.mark.parametrize(("seen", "gain"), [(7.0, 30.0), (5.0, 1.0)])
def test_a_cause_with_evidence_in_screening_but_not_in_its_fit_is_corrected(monkeypatch, seen, gain):
    lost, right = SimpleNamespace(log_evidence=-99.0), SimpleNamespace(log_evidence=-70.0)
    found = refitted(monkeypatch, "sliding", seen, [lost], lambda target, _: (target, right))
    assert found.gain == gain


def test_a_fit_starts_from_the_equilibria_of_the_one_that_it_extends():
    target = target_of(Relaxation(g=(0.4,), tau_s=(1.0,)))
    found = fit(target, [part(target, "relaxation", part="whole")])
    near = near_to(target, found)
    further = [*found.parts, part(target, "poisson")]
    with_start, starts = seen_starts(target, lambda: fit(target, further, near=near))
    assert starts[0] is near.solved is not None
    # The believed model's are further away.
    assert abs(fit(target, further, near=Near(near.x, near.jacobian)).objective - with_start.objective) < 0.01
    # What has no memory needs no start.
    assert near_to(target, fit(target, [part(target, "poisson")])).solved is None


def seen_starts(target, work):
    """Return the result of some work, and the solutions from which the predictions that it needed started."""
    starts, predictor = [], target.bench.predictor
    predict = predictor.predict
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            predictor, "predict", lambda *a, near=None, **k: (starts.append(near), predict(*a, near=near, **k))[1]
        )
        found = work()
    return found, starts


def test_a_model_without_equilibrium_at_once_is_near_without_equilibria(of_two, monkeypatch):
    found = fit(of_two, [part(of_two, "poisson")])
    monkeypatch.setattr(of_two.bench.predictor, "goes_through_time", lambda _: True)

    def fails(*_, **__):
        error = ConvergenceError("none")
        raise error

    monkeypatch.setattr(of_two.bench.predictor, "solved", fails)
    near = near_to(of_two, found)
    assert near.solved is None
    np.testing.assert_array_equal(near.jacobian, found.jacobian)


def test_a_fit_is_not_given_up_for_a_borrowed_jacobian_that_is_wrong(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    first, found = fit(of_two, parts[:1]), fit(of_two, parts)
    # A Jacobian of the wrong sign leads nowhere, one of zeros promises nothing.
    far = found.x + np.array([0.0, 2.5, 0.0])
    for at, of, factor in ((first.x, first, 0.0), (first.x, first, -1.0), (far, found, 0.0)):
        wrong = Near(at, factor * of.jacobian)
        for least in (-np.inf, found.log_evidence - 1.0):
            again = fit(of_two, parts, near=wrong, least=least)
            assert abs(again.objective - found.objective) < 0.5
    # Nor is it in the end, if all iterations gain.
    ended = fit(with_settings(of_two, most_iterations=1), parts, near=wrong)
    exact = fit(with_settings(of_two, most_iterations=0), parts, start=ended.x, near=wrong).jacobian
    np.testing.assert_allclose(ended.jacobian, exact, atol=1e-6 * np.abs(exact).max())


def test_a_jacobian_that_a_step_has_shown_to_be_right_suffices_to_give_up(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    # The first cause's row is known; a step of the second gains what is predicted, and nothing is left to gain.
    moved = found.x + np.array([0.0, 0.0, 3.0 * np.sqrt(found.covariance[2, 2])])
    near = Near(moved[:2], found.jacobian[:2])
    counts = {}
    for lacking in (1.0, 40.0):
        least = found.log_evidence + lacking
        again, counts[lacking] = predictions_of(
            of_two, lambda least=least: fit(of_two, parts, near=near, start=moved, least=least)
        )
        assert again.log_evidence == pytest.approx(found.log_evidence, abs=0.5)
    # By little, within what the known rows may hide, all rows are evaluated in the end; by much they are not.
    assert counts[40.0] == 1 + 1 + 1
    assert counts[1.0] >= counts[40.0] + 2
    # A large gain could go on; it is given up once the next step gains nothing.
    far = found.x + np.array([0.0, 0.0, 9.0 * np.sqrt(found.covariance[2, 2])])
    near, least = Near(far[:2], found.jacobian[:2]), found.log_evidence + 20.0
    _, calls = predictions_of(of_two, lambda: fit(of_two, parts, near=near, start=far, least=least))
    assert calls <= counts[40.0] + 1


def with_settings(target, **of_fits):
    """Return the same target with other settings of its fits."""
    bench = copy(target.bench)
    bench.settings = replace(DEFAULT, fit=replace(DEFAULT.fit, **of_fits))
    return replace(target, bench=bench)


def predictions_of(target, work):
    """Return the result of some work, and the number of predictions it needed."""
    found, starts = seen_starts(target, work)
    return found, len(starts)


def test_a_fit_that_begins_at_its_end_needs_its_jacobian_alone(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    again, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=found.x))
    assert calls == 1 + len(found.x) - 1  # the start, and one for each parameter: the modulus scales forces
    np.testing.assert_array_equal(again.x, found.x)


def test_a_fit_that_cannot_arrive_ends_early(of_two):
    wrong = [part(of_two, "latency")]
    both = fit(of_two, [part(of_two, "poisson"), *wrong])
    whole, calls = predictions_of(of_two, lambda: fit(of_two, wrong))
    assert whole.objective > both.objective + 100.0
    early, fewer = predictions_of(of_two, lambda: fit(of_two, wrong, least=both.log_evidence - 30.0))
    assert fewer < calls
    assert early.log_evidence < both.log_evidence - 30.0
    # One that can arrive is not given up.
    right = fit(of_two, [part(of_two, "poisson"), *wrong], least=both.log_evidence - 1.0)
    assert abs(right.objective - both.objective) < 0.3


def test_a_fit_that_misses_by_little_keeps_its_objective_and_saves_the_last_jacobian(of_two):
    parts = [part(of_two, "poisson")]
    exact, calls = predictions_of(of_two, lambda: fit(of_two, parts))
    least = exact.log_evidence + 3.0
    saved, fewer = predictions_of(of_two, lambda: fit(of_two, parts, least=least))
    assert saved.objective == pytest.approx(exact.objective, abs=1.0)
    assert fewer < calls


def test_a_fit_ends_where_no_step_is_expected_to_make_it_of_use(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    moved = found.x + np.array([0.0, 0.0, 5.0 * np.sqrt(found.covariance[2, 2])])
    # One step would bring it there, at the cost of some 12 nats that it lacks.
    near = found.log_evidence - 1.0
    again, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=moved, least=near))
    assert again.log_evidence > near
    assert calls > 1 + 2
    # A hundred nats more are out of reach: the Jacobian at the start tells.
    early, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=moved, least=near + 100.0))
    assert calls == 1 + 2
    np.testing.assert_array_equal(early.x, moved)


@pytest.mark.parametrize(
    ("uncorrected", "corrected", "tried", "taken"),
    [(-27.0, 3.0, 1, True), (-27.0, 1.0, 1, False), (-29.0, 40.0, 0, False)],
)
def test_a_rival_is_taken_for_what_it_gains_after_its_correction(monkeypatch, uncorrected, corrected, tried, taken):
    # It must be better by 2 nats, to which a correction may add 30.
    right, made = SimpleNamespace(log_evidence=corrected), []
    monkeypatch.setattr(candidates, "correctable", lambda *_: True)
    monkeypatch.setattr(candidates, "fit", lambda *_, **__: SimpleNamespace(log_evidence=uncorrected))
    monkeypatch.setattr(candidates, "corrected_fit", lambda *_: (made.append(1), ("better", right))[1])
    cause = FittedCause("poisson", None)
    current = SimpleNamespace(parts=(cause,), x=np.zeros(2), log_evidence=0.0, slices=lambda: [slice(1, 2)])
    target = SimpleNamespace(bench=SimpleNamespace(settings=DEFAULT))
    found = candidates.exchanged(target, current, 0, [(FittedCause("mooney", None), np.ones(1))])
    assert len(made) == tried
    assert found == (("better", right) if taken else (target, current))


def test_a_fit_that_begins_at_its_end_with_a_jacobian_needs_its_own_alone(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    near = Near(found.x, found.jacobian)
    again, calls = predictions_of(of_two, lambda: fit(of_two, parts, near=near))
    assert calls == 1 + 2
    np.testing.assert_array_equal(again.x, found.x)


def test_of_several_forms_each_is_fitted_as_far_as_its_correction_could_lead(of_two, monkeypatch):
    seen, nats = [], iter((-50.0, -90.0))

    def fitted(*_, least, **__):
        seen.append(least)
        return SimpleNamespace(log_evidence=next(nats))

    monkeypatch.setattr(candidates, "fit", fitted)
    base, bank = fit(of_two, []), {"mooney": list(CAUSES["mooney"].variants(of_two.bench))}
    screened, near = Screened(10.0, bank["mooney"][0], np.ones(1)), near_to(of_two, base)
    made = candidates._fit_forms(of_two, SimpleNamespace(bank=bank), screened, base, "mooney", -70.0, near)
    assert [one.log_evidence for one in made] == [-50.0, -90.0]
    assert seen == [-70.0, -70.0]
    seen.clear()
    nats = iter((-10.0, -90.0))
    candidates._fit_forms(of_two, SimpleNamespace(bank=bank), screened, base, "mooney", -70.0, near)
    assert seen == [-70.0, -10.0 - DEFAULT.model.correction_gain]


def test_a_fit_that_is_of_use_ends_as_it_would_without_a_limit(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    far = fit(of_two, parts).x + np.array([0.0, 1.5, 0.0])
    free, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=far))
    least = free.log_evidence - 0.1
    held, same = predictions_of(of_two, lambda: fit(of_two, parts, start=far, least=least))
    assert (same, held.log_evidence) == (calls, free.log_evidence)


def test_a_long_step_is_judged_by_what_its_part_should_gain(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    # Several steps of the greatest length away, with rows that are right: each gains most of what its part predicts.
    far = found.x + np.array([0.0, 0.0, 1.2 * found.deviation[2]])
    near = Near(far[:2], found.jacobian[:2])
    steps = with_settings(of_two, longest=0.4)
    again, calls = predictions_of(
        of_two, lambda: fit(steps, parts, start=far, near=near, least=found.log_evidence + 1.5)
    )
    assert again.log_evidence == pytest.approx(found.log_evidence, abs=0.5)
    gone, fewer = predictions_of(of_two, lambda: fit(steps, parts, start=far, near=near, least=1e6))
    assert gone.log_evidence < found.log_evidence - 10.0
    assert fewer == 1 + 1 + 1 < calls


def test_the_price_of_a_choice_counts_in_what_a_fit_must_reach(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    found = fit(of_two, parts)
    least = found.log_evidence - 30.0
    _, free = predictions_of(of_two, lambda: fit(of_two, parts, start=found.x, choices=2, least=least))
    moved = found.x + np.array([0.0, 0.0, 3.0 * np.sqrt(found.covariance[2, 2])])
    many = int(np.exp(40.0))
    _, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=moved, choices=many, least=least))
    assert calls == free == 1 + 2  # at its optimum, and given up at its start


def test_a_fit_takes_what_a_similar_one_knows_and_ends_alike(of_two):
    parts = [part(of_two, "poisson"), part(of_two, "latency")]
    first = fit(of_two, parts[:1])
    plain, calls = predictions_of(of_two, lambda: fit(of_two, parts, start=np.append(first.x, 0.0)))
    quick, fewer = predictions_of(of_two, lambda: fit(of_two, parts, near=near_to(of_two, first)))
    assert fewer < calls
    assert abs(quick.log_evidence - plain.log_evidence) < DEFAULT.fit.least_gain
    # Its Jacobian is its own in the end.
    np.testing.assert_allclose(quick.jacobian, plain.jacobian, atol=0.02 * np.abs(plain.jacobian).max())


def test_a_fit_begins_where_the_objective_is_least():
    torn = Detachment(boundary="base", azimuth_deg=100.0, share=0.3)
    target = target_of(torn)
    detached = part(target, "detachment", azimuth=90.0)
    base = fit(target, [])
    begin = best_start(target, [detached], near_to(target, base))
    places = [
        np.concatenate([base.x, start]) for start in (detached.free_parameters.start, *detached.free_parameters.starts)
    ]
    assert any(np.array_equal(begin, place) for place in places)
    left = [fit(target, [detached], start=place).objective for place in places[:2]]
    found = fit(target, [detached], start=begin)
    assert found.objective <= min(left) + 0.5
    assert abs(found.values(0, 1.0)[0]["share"] - 0.3) < 0.1
