"""Predictions on fine meshes: frames that have none, the cache, and inner targets."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rigs import rig
from support.targets import hidden
from tissuereg.diagnosis import refined
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.refined import entry_of, refined_predictions, refined_targets, solvable, targets_of
from tissuereg.diagnosis.run import target_rms
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.errors import ConvergenceError
from tissuereg.experiment.effects import Frame, Latency, Poisson, Relaxation, Set, Stiffness
from tissuereg.experiment.experiment import Simulated
from tissuereg.io.cache import read_entry
from tissuereg.simulation.experiment import simulate_plain
from tissuereg.simulation.fine import FineModel


def failing(monkeypatch, broken):
    """Let frames of fine meshes be without equilibrium: `broken` has their numbers by case."""
    simulate = FineModel.simulate

    def simulated(self, *args, **words):
        answers = simulate(self, *args, **words)
        for name, frames in broken.items():
            there = [frame for frame in frames if frame < len(answers[name].times)]
            for array in (answers[name].markers, *answers[name].forces.values()):
                array[there] = np.nan
            answers[name].failed.extend((frame, "no equilibrium") for frame in there)
        return answers

    monkeypatch.setattr(FineModel, "simulate", simulated)


def test_a_case_ends_before_frames_without_equilibrium_on_a_fine_mesh(monkeypatch):
    believed = rig()
    bench = Bench(believed, SignalLayout(believed))
    assert solvable(bench, keep=False) is bench
    bench.on_fine_meshes = None
    name = list(believed.cases)[1]
    failing(monkeypatch, {name: [2, 4]})
    with pytest.warns(UserWarning, match=f"3 of 5 .* case '{name}' are left out: from 12 s on .* no equilibrium"):
        cut = solvable(bench, keep=False)
    mine, given = cut.experiment.cases[name], believed.cases[name]
    assert np.array_equal(mine.times, given.times[:2])
    assert np.array_equal(mine.markers, given.markers[:2])
    for own, whole in ((mine.displacements, given.displacements), (mine.forces, given.forces)):
        assert all(np.array_equal(rows, whole[pad][:2]) for pad, rows in own.items())
    others = [case for case in believed.cases if case != name]
    assert all(cut.experiment.cases[other] is believed.cases[other] for other in others)
    assert cut.layout.size == bench.layout.size - 3 * (3 * 6 + 3)
    assert (cut.predictor.element, cut.settings) == (bench.predictor.element, bench.settings)
    with pytest.raises(ConvergenceError, match=f"frame 2 of case '{name}' does not"):
        refined_predictions(bench, None)


def test_a_case_that_was_cut_is_not_solved_again(monkeypatch):
    believed = rig()
    bench = Bench(believed, SignalLayout(believed))
    name = list(believed.cases)[1]
    failing(monkeypatch, {name: [2]})
    with pytest.warns(UserWarning, match="are left out"):
        cut = solvable(bench, keep=False)
    made = cut.on_fine_meshes.flat
    cut.on_fine_meshes = None
    fine, others = refined_predictions(cut, None)
    np.testing.assert_allclose(made, np.concatenate([fine[None], others]), atol=1e-6 * np.abs(made).max())


def test_a_case_without_a_loaded_frame_is_left_out_and_one_of_all_is_needed(monkeypatch):
    believed = rig()
    bench = Bench(believed, SignalLayout(believed))
    rest, one, two = believed.cases
    failing(monkeypatch, {one: [1]})
    with pytest.warns(UserWarning, match=f"all 5 frames of case '{one}'"):
        cut = solvable(bench, keep=False)
    assert list(cut.experiment.cases) == [rest, two]
    assert cut.on_fine_meshes.flat.shape == (4, cut.layout.size)
    bench.on_fine_meshes = None
    failing(monkeypatch, {two: [0]})
    with (
        pytest.warns(UserWarning, match="are left out"),
        pytest.raises(ConvergenceError, match="must have a loaded frame with an equilibrium"),
    ):
        solvable(bench, keep=False)


def test_the_answer_on_a_case_that_was_cut_has_a_report(monkeypatch, tmp_path):
    believed = rig()
    failing(monkeypatch, {list(believed.cases)[1]: [3]})
    with pytest.warns(UserWarning, match="2 of 5 frames"):
        told = tr.diagnose(believed, keep=False)
    assert "svg" in told.report(tmp_path / "report.html").read_text(encoding="utf-8")


def aimed():
    """The rig with two inner targets."""
    return replace(rig(), targets={"one": np.array([12.0, 9.0, 20.0]), "two": np.array([5.0, 15.0, 8.0])})


def bench_of(experiment, **how):
    return Bench(experiment, SignalLayout(experiment), **how)


def assert_same(found, expected, atol=1e-5):
    assert found.keys() == expected.keys()
    for case in expected:
        assert found[case].keys() == expected[case].keys()
        for name, places in expected[case].items():
            np.testing.assert_allclose(found[case][name], places, atol=atol)


def apart(one, other):
    """The largest distance between two predictions of targets, mm."""
    return max(np.abs(one[case][name] - other[case][name]).max() for case in one for name in one[case])


def test_inner_targets_are_predicted_by_the_fine_mesh():
    experiment, softer = aimed(), Poisson(poisson=0.2)
    believed, named = refined_targets(bench_of(experiment), [softer])
    model = FineModel(experiment)
    assert_same(believed, targets_of(model.simulate()))
    assert_same(named, targets_of(model.simulate([softer])))
    assert apart(named, targets_of(simulate_plain(replace(experiment, effects=(softer,))))) > 0.02


def test_targets_under_memory_have_the_correction_of_the_other_effects():
    experiment, memory, softer = aimed(), Relaxation(g=(0.4,), tau_s=(2.0,)), Poisson(poisson=0.2)
    for others in ((), (softer,), (Stiffness(young_kpa=12.0),)):
        believed, named = refined_targets(bench_of(experiment), [memory, *others])
        truth = targets_of(FineModel(experiment).simulate([memory, *others]))
        assert apart(named, truth) < 0.1 * apart(
            targets_of(simulate_plain(replace(experiment, effects=(memory, *others)))), truth
        )
        assert_same(believed, targets_of(FineModel(experiment).simulate()))


def test_effects_beside_a_believed_memory_go_through_time_on_the_fine_mesh():
    experiment, softer = replace(aimed(), effects=(Relaxation(g=(0.4,), tau_s=(2.0,)),)), Poisson(poisson=0.2)
    for effect in (softer, Set(fraction=0.2)):
        _, named = refined_targets(bench_of(experiment), [effect])
        assert_same(named, targets_of(FineModel(experiment).simulate((*experiment.effects, effect))))


def test_errors_of_the_tracker_move_no_target_and_a_body_of_this_mesh_needs_no_correction():
    experiment, softer = aimed(), Poisson(poisson=0.2)
    turned = Frame(rotation_deg=(0.0, 0.0, 2.0), shift_mm=(1.0, 0.0, 0.0))
    bench = bench_of(experiment)
    believed, named = refined_targets(bench, [turned, Stiffness(young_kpa=12.0)])
    assert named is believed
    uncorrected = replace(DEFAULT, model=replace(DEFAULT.model, corrected=False))
    simulated = replace(experiment, simulated=Simulated("plain", "tet4"))
    for one in (bench_of(experiment, settings=uncorrected), bench_of(simulated)):
        plain, changed = refined_targets(one, [softer])
        assert_same(plain, targets_of(simulate_plain(experiment)), atol=1e-12)
        assert_same(changed, targets_of(simulate_plain(replace(experiment, effects=(softer,)))), atol=1e-12)


def test_without_an_equilibrium_the_believed_prediction_stays(monkeypatch):
    experiment = aimed()
    bench = bench_of(experiment)
    refined_predictions(bench, None)

    def failed(*_, **__):
        message = "none"
        raise ConvergenceError(message)

    monkeypatch.setattr(FineModel, "simulate", failed)
    believed, named = refined_targets(bench, [Poisson(poisson=0.2)])
    assert named is None
    measured = {"down": {"one": believed["down"]["one"] + 3.0}}
    assert target_rms(measured, believed, named) == [pytest.approx(3.0), None]


def test_a_diagnosis_states_the_errors_at_targets_that_were_measured():
    experiment, memory = replace(aimed(), force_std=20.0), Relaxation(g=(0.4,), tau_s=(2.0,))
    given = hidden(experiment, Latency(latency_s=0.5), memory).cases
    # Targets may have been measured in some cases alone.
    cases = {
        name: replace(case, targets={"one": case.targets["one"]} if name == "down" else {})
        for name, case in given.items()
    }
    told = tr.diagnose(replace(experiment, cases=cases), keep=False)
    measured, added = {"down": cases["down"].targets}, told.extended.effects
    expected = target_rms(measured, *refined_targets(bench_of(experiment), added))
    assert told.findings
    for finding in told.to_json()["causes"]:
        stated = [finding["held_out"][key] for key in ("target_rms_base_mm", "target_rms_named_mm")]
        assert stated == pytest.approx(expected, rel=1e-4)


def test_the_cache_keeps_targets_and_other_targets_have_another_entry(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))
    experiment = aimed()
    bench = bench_of(experiment)
    refined_predictions(bench, entry_of(experiment))
    again = bench_of(experiment)
    monkeypatch.setattr(FineModel, "simulate", lambda *a, **k: pytest.fail("it was cached"))
    refined_predictions(again, entry_of(experiment))
    assert np.array_equal(again.on_fine_meshes.flat, bench.on_fine_meshes.flat)
    assert_same(again.on_fine_meshes.targets, bench.on_fine_meshes.targets, atol=0.0)
    moved = replace(experiment, targets={**experiment.targets, "two": np.array([5.0, 15.0, 9.0])})
    assert read_entry(entry_of(moved)) is None
    assert entry_of(experiment) == entry_of(aimed())
    monkeypatch.setattr(refined, "FINE_SCHEMA", -1)
    assert read_entry(entry_of(experiment)) is None


def test_targets_of_a_case_that_was_cut_end_with_it(monkeypatch):
    experiment = aimed()
    bench = bench_of(experiment)
    name = list(experiment.cases)[1]
    failing(monkeypatch, {name: [2]})
    with pytest.warns(UserWarning, match="are left out"):
        cut = solvable(bench, keep=False)
    assert all(rows.shape == (2, 3) for rows in cut.on_fine_meshes.targets[name].values())
    whole = bench.on_fine_meshes.targets[name]
    assert all(np.array_equal(rows, whole[of][:2]) for of, rows in cut.on_fine_meshes.targets[name].items())


def test_errors_at_targets_are_over_what_was_measured_and_all_models_predict():
    predicted = {"push": {"one": np.array([[3.0, 0.0, 4.0], [9.0, 9.0, 9.0]])}, "rest": {"one": np.ones((1, 3))}}
    measured = {"push": {"one": np.array([[0.0, 0.0, 0.0], [np.nan] * 3])}}
    assert target_rms(measured, predicted) == [pytest.approx(np.sqrt(25.0 / 3.0))]
    assert target_rms({"push": {"one": np.full((2, 3), np.nan)}}, predicted) == [None]
    whole = {"push": {"one": np.zeros((2, 3))}}
    gap = {"push": {"one": np.array([[1.0, 1.0, 1.0], [np.nan] * 3])}}
    assert target_rms(whole, predicted, gap) == [pytest.approx(np.sqrt(25.0 / 3.0)), pytest.approx(1.0)]
