"""Constancy of a cause: partitions of the data, phases of a load, and the test on data of a known kind."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tissuereg as tr
from support import targets
from support.rig_folders import write_rig
from tissuereg.cli import main
from tissuereg.diagnosis import constancy, run
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.constancy import AfterFit, FittedPart, fitted_parts, partitions, phases
from tissuereg.diagnosis.evidence import Null, tail_probability
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.report.page import findings
from tissuereg.diagnosis.settings import DEFAULT, ConstancySettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Latency, Poisson
from tissuereg.experiment.experiment import Actuator, Case

RAMP = np.r_[0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]
PLACES = np.random.default_rng(0).uniform(0.0, 40.0, (6, 3))


def made(mesh):
    """Return an experiment with two cases of the same ramp, in two directions."""
    rng, cases = np.random.default_rng(1), {}
    for number, name in enumerate(("first", "second")):
        command = np.zeros((len(RAMP), 3))
        command[:, number] = RAMP
        moved = PLACES + 0.1 * rng.standard_normal((len(RAMP), 6, 3)) + command[:, None]
        times = 20.0 * number + np.arange(len(RAMP))
        cases[name] = Case(name, times, moved, {"pad": command}, {}, {"pad": rng.standard_normal((len(RAMP), 3))})
    return SimpleNamespace(
        name="made",
        cases=cases,
        marker_names=tuple("abcdef"),
        marker_reference=PLACES,
        actuators=(Actuator("pad", np.arange(3), "displacement"),),
    )


@pytest.fixture(scope="module")
def rig():
    experiment = made(None)
    layout = SignalLayout(experiment)
    base = np.zeros(layout.size)
    for part in layout.parts:
        part.markers(base)[:] = experiment.cases[part.name].displacements["pad"][:, None]
    return experiment, layout, base


def test_phases_of_a_ramp_with_a_hold(rig):
    experiment, layout, _ = rig
    found = phases(experiment.cases["first"], layout["first"], 0.02)
    assert {name: np.flatnonzero(frames).tolist() for name, frames in found.items()} == {
        "before": [0, 1],
        "growing": [2, 3],
        "held": [4, 5],
        "held long": [6, 7],
        "falling": [8],
        "after": [9, 10],
    }


def test_a_case_without_load_is_before_it():
    case = Case("rest", np.arange(4.0), np.zeros((4, 1, 3)))
    found = phases(case, SimpleNamespace(n_frames=4), 0.02)
    assert list(found) == ["before"]
    assert found["before"].tolist() == [1.0] * 4


def test_partitions_weigh_every_number_by_what_they_are_named_for(rig):
    experiment, layout, base = rig
    found = partitions(experiment, layout, base)
    for name in ("load case", "phase of the load", "axis"):
        assert np.array_equal(found[name].sum(axis=0), np.ones(layout.size)), name
    second = layout["second"]
    assert np.flatnonzero(found["load case"][1]).tolist() == list(range(second.begin, second.end))
    assert np.array_equal(found["markers and forces"][0], ~layout.of_markers())
    whole, own = found["time"]
    assert whole[0] == -0.5
    assert second.forces(whole)[-1].tolist() == [[0.5] * 3]
    assert second.markers(own)[0, 0, 0] == -0.5
    standard = (PLACES - PLACES.mean(axis=0)) / PLACES.std(axis=0)
    for axis in range(3):
        assert np.allclose(second.markers(found["place"])[axis, 3, :, axis], standard[:, axis])
        assert not second.forces(found["place"])[axis].any()
        assert second.forces(found["axis"])[axis, 0, 0].tolist() == np.eye(3)[axis].tolist()
    load, squared = found["size of the load"]
    assert np.allclose(second.markers(load)[:, 0, 0], RAMP)
    assert np.allclose(squared, load**2)


def data(rig, seed, unlike):
    """Return what is left of data that a cause explains but for a share `unlike` of its change in the second case."""
    experiment, layout, base = rig
    rng = np.random.default_rng(seed)
    change = np.zeros(layout.size)
    for part in layout.parts:
        part.markers(change)[:] = RAMP[:, None, None] * np.sin(PLACES[:, :1] / 20.0 + np.arange(3.0))
    change *= 30.0 / np.linalg.norm(change)
    null = Null(rng.standard_normal((3, layout.size)) / np.sqrt(layout.size))
    rows = rng.standard_normal((301, layout.size)) + rng.standard_normal((301, 3)) @ null.nuisances
    rows[0] += unlike * (layout.of_case("second") - 0.5) * change
    reduced = null.reduced(rows)
    left = AfterFit.of(reduced[0], reduced[1:], null.reduced(change[None]))
    return left, change, partitions(experiment, layout, base), null.reduced


def judged(left, change, columns, parts, reduced, settings=DEFAULT.constancy):
    """Return the p-value of a cause and the partition over which it is least constant; None where it has none."""
    unlike = left.inconstancies(change, columns, parts, reduced, settings)
    found = FittedPart("latency", (), left, None, unlike).constancy(settings.level)
    return None if found is None else (found.p, found.differs_by)


def test_p_values_of_a_true_cause_are_uniform(rig):
    found = [
        judged(left, change, change[None], parts, of)[0]
        for left, change, parts, of in (data(rig, k, 0.0) for k in range(60))
    ]
    assert 0.35 < np.mean(found) < 0.65
    assert min(found) > 1e-3
    assert np.mean(np.array(found) < 0.25) == pytest.approx(0.25, abs=0.15)


def test_a_cause_that_is_larger_in_one_case_is_inconstant_over_cases(rig):
    for seed in range(5):
        left, change, parts, reduced = data(rig, seed, 0.8)
        p, differs_by = judged(left, change, change[None], parts, reduced)
        assert p < 1e-6
        assert differs_by == "load case"


def test_an_inconstancy_of_one_parameter_alone_is_found(rig):
    layout = rig[1]
    left, change, parts, reduced = data(rig, 3, 0.0)
    rng = np.random.default_rng(9)
    columns = np.stack([change, 30.0 * rng.standard_normal(layout.size) / np.sqrt(layout.size)])
    extra = 0.5 * (layout.of_case("first") - 0.5) * columns[1]
    own = AfterFit.of(left.residual + reduced(extra), left.draws, reduced(columns))
    p, differs_by = judged(own, change, columns, parts, reduced)
    assert p < 1e-3
    assert differs_by == "load case"
    assert judged(own, change, columns[:1], parts, reduced)[0] > 0.01


def test_the_size_of_the_noise_counts_for_nothing(rig):
    left, change, parts, reduced = data(rig, 4, 0.3)
    loud, louder = (AfterFit(size * left.residual, left.draws, left.own) for size in (1.3, 2.0))
    p, _ = judged(loud, change, change[None], parts, reduced)
    assert judged(louder, change, change[None], parts, reduced)[0] == pytest.approx(p, rel=1e-6)
    # A residual below the noise speaks against no cause.
    assert judged(AfterFit(0.3 * left.residual, left.draws, left.own), change, change[None], parts, reduced)[0] > 0.3


def test_what_the_parameters_themselves_change_is_no_inconstancy(rig):
    left, change, parts, reduced = data(rig, 0, 0.0)
    everything = np.concatenate([change * weights for weights in parts.values()])
    own = AfterFit.of(left.residual, left.draws, reduced(everything))
    assert judged(own, change, change[None], parts, reduced) is None
    assert np.abs(own.draws @ own.own.T).max() < 1e-9


def test_small_parts_of_a_change_do_not_count(rig):
    left, change, parts, reduced = data(rig, 0, 0.8)
    assert judged(left, change, change[None], parts, reduced, ConstancySettings(least_change=1.0)) is None


def test_a_tail_goes_on_beyond_the_draws():
    drawn = np.random.default_rng(0).gumbel(size=2000)
    assert tail_probability(0.0, drawn) == pytest.approx(1.0 - np.exp(-1.0), abs=0.03)
    assert tail_probability(12.0, drawn) == pytest.approx(np.exp(-12.0), rel=0.5)
    assert tail_probability(float(drawn.max()) + 1e-9, drawn) <= 1.0 / 2000


def judged_causes(truth, *parts, seed=0, settings=DEFAULT.constancy):
    """Return the tests of causes that are fitted to data with other effects, by id."""
    target = targets.target_of(*truth, marker_std=0.01)
    found = fit(
        target, [targets.part(target, *one) if isinstance(one, tuple) else targets.part(target, one) for one in parts]
    )
    by_modulus = target.white(target.bench.young_spread * target.bench.by_young[:1])
    null = Null(np.where(target.bench.layout.seen, by_modulus, 0.0))
    draws = np.stack([target.noise.draw(target.bench.layout, np.random.default_rng([2, k])) for k in range(300)])
    drawn = null.reduced(draws + np.random.default_rng(3).standard_normal((300, 1)) @ null.nuisances)
    parts = fitted_parts(target, found, null, drawn, seed, settings)
    return {one.id: one for one in (part.constancy(settings.level) for part in parts) if one is not None}


def test_a_true_cause_is_constant_and_one_that_stands_for_it_is_not():
    right = judged_causes([Poisson(poisson=0.47)], "poisson")["poisson"]
    assert right.holds
    assert right.p > 0.01
    wrong = judged_causes([Poisson(poisson=0.47)], "actuator_gain")["actuator_gain"]
    assert not wrong.holds
    assert wrong.p < 1e-6
    assert wrong.to_json() == {"id": wrong.id, "p": wrong.p, "differs_by": wrong.differs_by, "holds": False}


def test_a_form_that_may_be_off_explains_more():
    found = [
        judged_causes([Poisson(poisson=0.47)], "actuator_gain", settings=ConstancySettings(form_error=share))
        for share in (0.0, 0.03, 0.3)
    ]
    exact, usual, loose = (one["actuator_gain"].p for one in found)
    assert 1e3 * exact < usual
    assert 1e3 * usual < loose


def test_each_of_two_causes_is_tested_beside_the_error_of_the_other(monkeypatch):
    given = []

    def noted(bench, change):
        given.append(change)
        return effect_nuisances(bench, change)

    monkeypatch.setattr(constancy, "effect_nuisances", noted)
    both = judged_causes([Poisson(poisson=0.47), Latency(latency_s=0.3)], "poisson", "latency")
    assert set(both) == {"poisson", "latency"}
    assert all(one.holds for one in both.values())
    # The tracker's delay moves no force, and nothing at rest.
    forces = ~SignalLayout(targets.rig()).of_markers()
    assert [bool(np.abs(change[forces]).max() > 1e-9) for change in given] == [False, True]


def test_data_are_drawn_with_the_error_of_the_other_cause_too(monkeypatch):
    drawn, direction = [], np.zeros(SignalLayout(targets.rig()).size)
    direction[:7] = 0.5

    def noted(residual, draws, slopes):
        drawn.append(draws)
        return AfterFit(residual, draws, np.zeros((0, len(residual))))

    monkeypatch.setattr(constancy, "effect_nuisances", lambda bench, change: direction[None])
    monkeypatch.setattr(constancy.AfterFit, "of", noted)
    judged_causes([Poisson(poisson=0.47), Latency(latency_s=0.3)], "poisson", "latency")
    for draws in drawn:
        # The error is fifty noise deviations long; whitened by it too, the draws have unit variance along it.
        assert np.std(draws @ direction / np.linalg.norm(direction)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", ["marker_slip", "sliding", "detachment"])
def test_what_begins_to_act_somewhere_is_not_tested(name):
    assert not CAUSES[name].constant
    if name == "marker_slip":
        assert judged_causes([Poisson(poisson=0.47)], name) == {}


def test_an_inconstant_cause_is_said_on_the_page_and_no_finding(tmp_path, monkeypatch):
    given, asked = [], []

    def parts(*arguments):
        asked.append(arguments[-1])
        # Of 10,000 draws this share has as much evidence.
        drawn = np.r_[0.0, np.where(np.arange(10_000) < 1e4 * given[-1], 1.0, -1.0)]
        left = AfterFit(np.zeros(1), np.zeros((10_000, 1)), np.zeros((0, 1)))
        return [FittedPart("latency", (), left, None, [("time", drawn)])]

    monkeypatch.setattr(run, "fitted_parts", parts)
    monkeypatch.setattr(run, "memberships", lambda *arguments: {})
    rig = write_rig(tmp_path / "rig", "sets")
    main(["simulate", str(rig), "--plain", "--noise", "--seed", "1", "--out", str(tmp_path / "made"), "--quiet"])
    made, late = tr.read_experiment(tmp_path / "made"), Latency(latency_s=0.4)
    cases = {
        name: replace(case, markers=late.seen(case.markers, case.times, made.marker_names))
        for name, case in made.cases.items()
    }
    experiment = replace(made, cases=cases)
    given.append(0.5)
    stated = tr.diagnose(experiment, keep=False)
    assert [one.id for one in stated.findings] == ["latency"]
    assert stated.to_json()["constancy"] == [
        {"id": "latency", "p": pytest.approx(0.5, abs=0.01), "differs_by": "time", "holds": True}
    ]
    assert stated.to_json()["causes"][0]["family"] is None
    given.append(5e-4)
    found = tr.diagnose(experiment, keep=False)
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert found.to_json()["constancy"][0]["holds"] is False
    assert asked == [DEFAULT.constancy] * len(asked)
    assert "its change differs by time (p = 0.0005)" in findings(found)
    assert "its change differs" not in findings(stated)


@pytest.mark.parametrize(
    ("shares", "asked", "stays", "given_up"),
    [
        # In each search the causes' p-values by round; None: a round whose cause went beside later ones.
        ({3: (0.5, 0.4, 0.3)}, [3], (0.5, 0.4, 0.3), ()),
        # The third goes, the two before it are tested again without it.
        ({3: (0.5, 0.4, 6e-4), 2: (0.2, 0.3)}, [3, 2], (0.2, 0.3), (6e-4,)),
        # The second goes with the third, though that is constant beside it.
        ({3: (0.5, 5e-4, 0.4), 1: (0.3,)}, [3, 1], (0.3,), (5e-4, 0.4)),
        ({3: (0.5, 0.4, 5e-4), 2: (0.4, 6e-4), 1: (7e-4,)}, [3, 2, 1], (7e-4,), (6e-4, 5e-4)),
        # Without the first there is nothing to test.
        ({3: (7e-4, 0.4, 5e-4)}, [3], (7e-4, 0.4, 5e-4), ()),
        # What had gone beside the third may come back without it.
        ({3: (0.5, None, 5e-4), 2: (0.5, 0.4)}, [3, 2], (0.5, 0.4), (5e-4,)),
        ({3: (None, 5e-4, 0.4), 1: (0.4,)}, [3, 1], (0.4,), (5e-4, 0.4)),
    ],
)
def test_a_later_cause_that_is_not_constant_is_given_up_with_those_after_it(
    shares, asked, stays, given_up, monkeypatch
):
    searched = []

    def search(target, screen, thresholds, most):
        searched.append(most)
        found = {number: p for number, p in enumerate(shares[most]) if p is not None}
        return SimpleNamespace(target=None, final=list(found.values()), rounds=lambda: found)

    def parts(target, final, *rest):
        left = AfterFit(np.zeros(1), np.zeros((10_000, 1)), np.zeros((0, 1)))
        drawn = [np.r_[0.0, np.where(np.arange(10_000) < 1e4 * share, 1.0, -1.0)] for share in final]
        return [FittedPart("layer", (), left, None, [("time", one)], number) for number, one in enumerate(drawn)]

    monkeypatch.setattr(run, "search", search)
    monkeypatch.setattr(run, "fitted_parts", parts)
    rules = replace(DEFAULT, search=replace(DEFAULT.search, most_causes=3))
    believed = SimpleNamespace(target=SimpleNamespace(bench=SimpleNamespace(settings=rules)), null=None)
    found, ready, tested, gone = run._constant(believed, None, SimpleNamespace(thresholds={}, residuals=None), 0)
    assert searched == asked
    assert len(ready) == len(found.final) == len(stays)
    assert [one.p for one in tested] == pytest.approx(stays, abs=5e-5)
    assert [one.p for one in gone] == pytest.approx(given_up, abs=5e-5)
