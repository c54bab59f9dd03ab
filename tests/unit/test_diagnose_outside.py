"""Effects outside the catalogue: their columns against other code, and what findings must beat."""

import argparse
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rig_folders import write_rig
from support.rigs import rig
from support.targets import finding_of, part, target_of
from tissuereg.body.load import Load
from tissuereg.cli import diagnose as command
from tissuereg.cli.common import Stopwatch
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.candidates import without
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.regions import balls_in, shares_of_balls
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import FittedCause, fit
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.outside import (
    OUTSIDE,
    Outside,
    OutsideBank,
    _clock,
    _growth,
    _pad_variants,
    outside_tests,
    outside_variants,
)
from tissuereg.diagnosis.run import _beside
from tissuereg.diagnosis.screen import Screen, make_bank, make_outside
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import ActuatorDirection, ActuatorGain, Inclusion, Latency, Swelling
from tissuereg.experiment.experiment import Simulated
from tissuereg.simulation.experiment import simulate_plain

BALL = Inclusion(centre_mm=(12.0, 10.0, 24.0), semi_axes_mm=(7.0, 7.0, 7.0), contrast=5.0)


def bench_of(experiment=None, settings=DEFAULT, element="tet4"):
    experiment = experiment or rig()
    return Bench(experiment, SignalLayout(experiment), settings=settings, element=element)


@pytest.fixture(scope="module")
def bench():
    return bench_of()


@pytest.fixture(scope="module")
def variants(bench):
    return outside_variants(bench)


def with_modulus(experiment, factors):
    material = replace(experiment.material, young=np.asarray(experiment.material.young * factors))
    return replace(experiment, material=material)


def test_the_columns_of_a_modulus_that_varies_are_its_differences(bench, variants):
    rules, mesh = DEFAULT.outside, bench.experiment.mesh
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) / (rules.lengths[-1] * bench.extent)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart**2))
    columns = variants["stiffness-field"][-1].columns
    for k in (1, 2):
        pattern = np.sqrt(values[-k]) * vectors[:, -k]
        more, less = (
            bench_of(with_modulus(bench.experiment, 1.0 + sign * 0.02 * pattern)).base for sign in (1.0, -1.0)
        )
        wanted = (more - less) / 0.04
        sign = np.sign(columns[k - 1] @ wanted)
        np.testing.assert_allclose(sign * columns[k - 1], wanted, atol=2e-3 * np.abs(wanted).max())


def test_the_patterns_have_the_variance_of_the_modulus(variants):
    # Blocks of all lengths are as long; those of longer waves end in zeros.
    blocks = [one.columns for one in variants["stiffness-field"]]
    assert len({len(block) for block in blocks}) == 1
    used = [int(np.abs(block).any(axis=1).sum()) for block in blocks]
    assert used[0] > used[1] > used[2] > 3


def test_a_place_grows_with_the_time_since_the_first_frame(bench, variants):
    rest = bench.layout["rest"]
    for variant in variants["growing-place"][:3]:
        moved = rest.markers(variant.columns)[0]
        assert np.abs(moved[-1]).max() > 0.0
        np.testing.assert_allclose(moved, (rest.times - rest.times[0])[:, None, None] * moved[-1] / 7.0, atol=1e-9)


def test_a_held_place_pulls_with_its_stiffness_times_its_motion(bench, variants):
    mesh, tangents, rules = bench.experiment.mesh, bench.tangents, DEFAULT.outside
    balls = balls_in(mesh, rules.radii, rules.spacing)
    number = len(balls) - 1
    share = shares_of_balls(mesh, balls).toarray()[:, number]
    weights = np.zeros(mesh.n_nodes)
    np.add.at(weights, mesh.tets, (share * mesh.volumes)[:, None])
    weights *= 10.0 * mesh.extent / weights.sum()

    def pulled(state):
        at = next(k for k, one in enumerate(tangents.states) if one is state)
        return [Load(forces=-weights[:, None] * tangents._at(at)[2])]

    wanted = bench.by(pulled, 1)[0]
    assert np.abs(wanted).max() > 1.0
    found = variants["held-place"][number]
    np.testing.assert_allclose(found.columns[0], wanted, atol=1e-9 * np.abs(wanted).max())
    assert found.positive


def in_parts(experiment):
    """Return the experiment of a body whose upper half is ten times as stiff."""
    height = experiment.mesh.nodes[experiment.mesh.tets].mean(axis=1)[:, 2]
    return with_modulus(experiment, np.where(height > 20.0, 10.0, 1.0))


@pytest.mark.parametrize("element", ["tet4", "tet4-averaged", "tet10"])
@pytest.mark.parametrize("of", [lambda experiment: experiment, in_parts], ids=["uniform", "in parts"])
def test_the_growth_of_the_whole_body_is_that_of_swelling(of, element):
    bench = bench_of(of(rig()), element=element)
    mesh = bench.experiment.mesh
    whole = (3.0 * mesh.extent, tuple(mesh.nodes.mean(axis=0)))
    forces = _growth(bench, shares_of_balls(mesh, [whole])).toarray()[0].reshape(-1, 3)
    at_full = bench.by(lambda state: [Load(forces=forces)], 1)[0]
    size = 1e-3
    grown = bench.predictor.predict([Swelling(linear_strain=size, from_time_s=0.0, to_time_s=24.0)]) - bench.base
    # Where pads are attached, swelling begins anew with the case.
    rest = bench.layout.of_case("rest") & bench.layout.of_markers()
    wanted, found = grown[rest] / size, (at_full * _clock(bench))[rest]
    np.testing.assert_allclose(found, wanted, atol=3e-3 * np.abs(wanted).max())


def test_the_columns_of_a_pads_motion_hold_gain_and_direction_also_back_and_forth():
    believed = rig()
    name = list(believed.cases)[-1]
    case = believed.cases[name]
    there = np.array([0.0, 0.6, 1.0, -0.7, 0.2])[:, None] * np.array([-2.5, 0.5, 0.0])
    bench = bench_of(replace(believed, cases={**believed.cases, name: replace(case, displacements={"side": there})}))
    for variant in outside_variants(bench)["pad-motion"]:
        for effect in (
            ActuatorGain(actuator=variant.label, gain=1.001),
            ActuatorDirection(actuator=variant.label, rotation_deg=(0.0, 0.05, 0.02)),
        ):
            change = bench.change(effect)
            assert np.abs(change).max() > 0.0
            shares = np.linalg.lstsq(variant.columns.T, change)[0]
            np.testing.assert_allclose(shares @ variant.columns, change, atol=2e-3 * np.abs(change).max())
        assert len(variant.columns) == 36


def test_a_turn_of_a_pad_moves_its_rim_as_far_as_a_shift(monkeypatch):
    bench, made = bench_of(), {}

    def by(direction, count):
        made.update({(state.case.name, state.frame): direction(state) for state in bench.tangents.states})
        return np.zeros((count, 1))

    monkeypatch.setattr(bench, "by", by)
    assert [one.label for one in _pad_variants(bench)] == ["top", "side"]
    # The pad at the top moves along z, three mm at most and half as far before.
    far, half = (np.array([np.abs(load.prescribed).max() for load in made["down", k][:36]]) for k in (2, 1))
    full = np.array([np.linalg.norm(load.prescribed, axis=1).max() for load in made["down", 2][:36]])
    along = np.r_[12:18]
    np.testing.assert_allclose(full[along[:3]], 3.0)
    assert full[along[3:]].max() == pytest.approx(3.0)
    np.testing.assert_allclose(far[along + 18], far[along])
    np.testing.assert_allclose(half[along], 0.5 * far[along])
    np.testing.assert_allclose(half[along + 18], 0.25 * far[along])
    # The other pad is not there.
    assert not any(load.prescribed.any() for load in made["down", 2][36:])


def test_a_pad_of_one_node_turns_nothing():
    believed = rig()
    top, side = believed.actuators
    variants = outside_variants(bench_of(replace(believed, actuators=(replace(top, nodes=top.nodes[:1]), side))))
    assert np.isfinite(variants["pad-motion"][0].columns).all()


@pytest.mark.parametrize(
    ("rules", "left_out"),
    [
        ({"lengths": ()}, {"stiffness-field"}),
        ({"radii": ()}, {"held-place", "growing-place"}),
        ({"motions": (), "holds": ()}, {"pad-motion", "held-place"}),
    ],
)
def test_a_kind_without_sizes_or_places_is_left_out(rules, left_out):
    bench = bench_of(settings=replace(DEFAULT, outside=replace(DEFAULT.outside, **rules)))
    variants = outside_variants(bench)
    assert set(OUTSIDE) - set(variants) == left_out
    bank = OutsideBank(variants, lambda columns: columns)
    size = bench.layout.size
    assert set(bank.evidence(np.ones(size), Null(np.zeros((0, size))), bench.settings.outside)) == set(variants)


def fitted(*effects, believed=None, beside=()):
    """Return how causes stand that are fitted to data of a body with effects, or of another body.

    They are an inclusion, and those of `beside`, which the data have too.
    """
    target = target_of(*effects)
    bench, layout = target.bench, target.bench.layout
    if believed is not None:
        layout.measured[:] = believed.base + _noise(layout)
    null = Null(target.white(bench.by_young) * bench.young_spread)
    parts = [part(target, name) for name in beside]
    current = fit(target, parts)
    balls = {"inclusion": list(CAUSES["inclusion"].variants(bench))}
    screen = Screen(balls, np.zeros((1, 1, layout.size)), target.noise, layout, target.correction, null)
    seen = screen.of(null.reduced(current.residual))["inclusion"]
    start = CAUSES["inclusion"].free_parameters(bench, seen.best, seen.amplitudes)
    found = fit(target, [*parts, FittedCause("inclusion", start)])
    rests = [without(target, found, number) for number in range(len(found.parts))]
    return target, found, rests, null, OutsideBank(outside_variants(bench), target.white)


def judged(*effects, **words):
    return outside_tests(*fitted(*effects, **words))


def _noise(layout):
    rng = np.random.default_rng(5)
    return np.where(layout.of_markers(), 0.01, 2.0) * rng.standard_normal(layout.size)


def test_a_ball_beats_what_is_outside_where_there_is_one():
    (found,) = judged(BALL)
    assert found.log_bayes_factor > 20.0
    assert found.holds
    assert found.probability > 0.9
    assert set(found.kinds) == set(OUTSIDE)


def test_shares_follow_from_tempered_evidence_and_families():
    target, found, rests, null, bank = fitted(BALL)
    bench = copy(target.bench)
    bench.settings = replace(DEFAULT, evidence=replace(DEFAULT.evidence, temper=20.0))
    (one,) = outside_tests(replace(target, bench=bench), found, rests, null, bank)
    weights = {kind: np.exp((nats - one.log_bayes_factor) / 20.0) for kind, nats in one.kinds.items()}
    whole = 1.0 + sum(weights.values())
    assert one.probability == pytest.approx(1.0 / whole)
    assert one.family_probability == pytest.approx((1.0 + weights["stiffness-field"]) / whole)
    assert one.probability < 0.9


def test_a_cause_of_the_body_may_be_off_in_form_and_one_of_the_tracker_is_exact():
    target, found, rests, null, bank = fitted(BALL, Latency(latency_s=0.1), beside=["latency"])
    late, ball = outside_tests(target, found, rests, null, bank)
    gains = [found.log_evidence - rest.log_evidence for rest in rests]
    # Seven per cent of its change explain a part of what the ball does.
    assert ball.log_bayes_factor < 0.8 * gains[1]
    alone, only, _, nothing, _ = fitted(BALL, Latency(latency_s=0.1), beside=["latency"])
    exact = fit(alone, [only.parts[0]], start=only.x[:2])
    (one,) = outside_tests(alone, exact, [fit(alone, [])], nothing, bank)
    plain = exact.log_evidence - fit(alone, []).log_evidence
    won = 0.5 * ((fit(alone, []).residual ** 2).sum() - (exact.residual**2).sum())
    reduced = [nothing.reduced(each.residual) for each in (fit(alone, []), exact)]
    assert one.log_bayes_factor == pytest.approx(
        plain - won + 0.5 * ((reduced[0] ** 2).sum() - (reduced[1] ** 2).sum()), rel=1e-6
    )
    assert late.id == one.id == "latency"


def test_a_ball_beats_what_is_outside_also_beside_another_cause():
    late, ball = judged(BALL, Latency(latency_s=0.1), beside=["latency"])
    assert (late.id, ball.id) == ("latency", "inclusion")
    assert min(late.probability, ball.probability) > 0.9


def test_gains_do_not_depend_on_the_nuisances_under_which_causes_were_fitted():
    target, found, rests, null, bank = fitted(BALL)
    (plain,) = outside_tests(target, found, rests, null, bank)
    change = target.white(effect_nuisances(target.bench, found.prediction - rests[0].prediction))
    wide = replace(target, null=Null(change))
    again = [fit(wide, one.parts, start=one.x) for one in (found, rests[0])]
    (other,) = outside_tests(wide, again[0], again[1:], null, bank)
    assert rests[0].log_evidence - again[1].log_evidence < -100.0
    assert other.log_bayes_factor == pytest.approx(plain.log_bayes_factor, abs=0.1 * plain.log_bayes_factor)


def test_a_modulus_that_rises_from_end_to_end_beats_a_ball():
    experiment = rig()
    mesh = experiment.mesh
    height = mesh.nodes[mesh.tets].mean(axis=1)[:, 0] / mesh.nodes[:, 0].max()
    (found,) = judged(believed=bench_of(with_modulus(experiment, np.exp(1.2 * (height - 0.5)))))
    assert not found.holds
    assert found.nearest == "stiffness-field"
    assert found.family_probability == pytest.approx(1.0)


def test_a_cause_without_which_there_is_no_equilibrium_has_no_rival():
    target, found, _, null, bank = fitted(BALL)
    (one,) = outside_tests(target, found, [None], null, bank)
    assert (one.probability, one.nearest, one.holds) == (1.0, None, True)


@pytest.mark.parametrize(
    ("probability", "family", "holds", "alone"),
    [
        (0.88, 1.0, True, False), (0.12, 1.0, True, True), (0.12, 0.4, False, False),
        (0.018, 1.0, False, False), (0.5, 0.5, True, False),
    ],
)  # fmt: skip
def test_what_may_be_stated_follows_from_the_shares(probability, family, holds, alone):
    one = Outside("inclusion", 20.0, {"stiffness-field": 21.0}, probability, family, DEFAULT)
    assert (one.holds, one.holds_family) == (holds, alone)
    assert one.to_json()["holds"] is holds


def test_the_probability_of_a_finding_is_shared_with_what_is_outside():
    mean = finding_of(("inclusion",), probability=0.9, log_bayes_factor=20.0, group_probability=0.95)
    shared = _beside(mean, Outside("inclusion", 20.0, {}, 0.8, 0.9, DEFAULT))
    assert (shared.probability, shared.group_probability) == pytest.approx((0.72, 0.76))
    assert shared.is_sure
    alone = _beside(mean, Outside("inclusion", 20.0, {}, 0.4, 0.9, DEFAULT))
    assert (alone.probability, alone.group_probability) == pytest.approx((0.36, 0.855))
    assert not alone.is_sure


def test_hypotheses_are_kept_and_depend_on_the_body_alone(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))
    first = make_outside(bench)
    said = []
    again = bench_of(settings=replace(DEFAULT, outside=replace(DEFAULT.outside, holds=(0.5,))))
    again.progress = said.append
    second = make_outside(again)
    assert said == []
    for kind, several in first.items():
        np.testing.assert_array_equal(several[-1].columns, second[kind][-1].columns)
    assert list(second) == list(OUTSIDE)
    assert set(make_bank(bench)).isdisjoint(OUTSIDE)


def test_what_is_outside_is_unexplained_and_said(tmp_path):
    believed = tr.read_experiment(write_rig(tmp_path / "rig", "sets"))
    mesh = believed.mesh
    across = mesh.nodes[mesh.tets].mean(axis=1)[:, 0]
    share = (across - across.min()) / np.ptp(across)
    answers = simulate_plain(with_modulus(believed, np.exp(2.0 * (share - 0.5))))
    rng = np.random.default_rng(3)

    def seen(places, std):
        return places + std * rng.standard_normal(places.shape)

    cases = {
        name: replace(
            case,
            markers=seen(answers[name].markers, believed.marker_std),
            forces={pad: seen(force, believed.force_std) for pad, force in answers[name].forces.items()},
        )
        for name, case in believed.cases.items()
    }
    plain = Simulated("plain", "tet4", "0" * 64)
    told = tr.diagnose(replace(believed, cases=cases, simulated=plain), keep=False)
    assert told.verdict == "unexplained"
    assert "stiffness that varies through the body" in told.next_experiment["action"]
    assert not told.outside[0].holds
    assert told.to_json()["outside"][0]["kinds"] == told.outside[0].kinds
    words = "stiffness that varies through the body otherwise than in one ball or layer explains the data as well"
    page = told.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Of the causes it fits best, but " + words in page
    said = command._outcome(
        told.to_json(), Stopwatch(), argparse.Namespace(out=None, exit_code=False, verbose=0, threads=1)
    )
    assert f"{told.outside[0].id} fits best of the causes, but {words}" in said.summary
