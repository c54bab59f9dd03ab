"""A whole diagnosis gives the same answer every time, on any number of threads."""

import ctypes
import platform
from dataclasses import replace
from threading import Barrier, Lock, active_count

import numpy as np
import pytest

import tissuereg as tr
from support.answers import told
from support.rigs import rig
from tissuereg._base.provenance import recorded
from tissuereg.body.material import Material
from tissuereg.diagnosis import predictor, readings, run
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.predictor import Predictor
from tissuereg.diagnosis.report.charts import proofs_of
from tissuereg.diagnosis.run import _own_modulus
from tissuereg.diagnosis.screen import make_bank
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.errors import LockingWarning
from tissuereg.experiment.effects import Poisson, Relaxation, Set, Stiffness, Swelling
from tissuereg.experiment.experiment import Simulated
from tissuereg.simulation.experiment import solve_cases

RELAXATION = Relaxation(g=(0.4,), tau_s=(2.0,))


def test_the_answer_depends_on_neither_threads_nor_the_call():
    # Its markers do not move, though forces at pads are as predicted: nothing explains that, all causes are tried.
    believed = rig()
    said = tr.simulate_experiment(believed)
    cases = {name: replace(case, forces=dict(said[name].forces)) for name, case in believed.cases.items()}
    still = replace(believed, cases=cases)
    one, again, two = (told(tr.diagnose(still, threads=threads, keep=False)) for threads in (1, 1, 2))
    assert one["verdict"] == "unexplained"
    assert len(one["candidates"]) > 20
    assert one == again == two


def test_of_forces_below_their_noise_no_modulus_is_stated_that_the_search_found():
    believed = replace(rig(), young_std=0.6)
    said, rng = tr.simulate_experiment(believed, model="plain"), np.random.default_rng(0)
    cases = {
        name: replace(
            case,
            markers=said[name].markers,
            forces={pad: 2.0 * rng.standard_normal(force.shape) for pad, force in case.forces.items()},
        )
        for name, case in believed.cases.items()
    }
    found = tr.diagnose(replace(believed, cases=cases, simulated=Simulated("plain", "tet4", "0" * 64)), keep=False)
    assert [one.kind for one in found.suspicions] == ["silent"]
    assert found.details.search.final.ids == ("stiffness",)
    assert [one.id for one in found.outside] == ["stiffness"]
    assert found.findings == ()
    assert proofs_of(found) == {}


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_work_within_work_solves_no_more_bodies_at_a_time_than_there_are_threads(threads, monkeypatch):
    believed = rig()
    bench = Bench(believed, SignalLayout(believed), threads=threads)
    lock, running, most = Lock(), 0, 0
    # Without a timeout of its own a barrier would wait for threads that are not let in.
    together = Barrier(threads, timeout=30.0)

    def solved(worked, cases, **options):
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        together.wait()
        found = solve_cases(worked, cases, **options)
        with lock:
            running -= 1
        return found

    _ = bench.base
    monkeypatch.setattr(predictor, "solve_cases", solved)

    def changes(number):
        return bench.changes([[Poisson(poisson=0.3 + 0.01 * (4 * number + part))] for part in range(4)])

    found = bench.side_by_side(changes, range(threads))
    monkeypatch.undo()
    assert most == threads
    # Which has kept none of these solutions.
    bench = Bench(believed, SignalLayout(believed), threads=1)
    for number, made in enumerate(found):
        for one, again in zip(made, changes(number), strict=True):
            np.testing.assert_array_equal(one, again)


@pytest.mark.parametrize(
    ("effect", "apart"),
    [
        (RELAXATION, True),
        (Set(fraction=0.2), False),
        (Swelling(linear_strain=0.02, from_time_s=0.0, to_time_s=4.0), False),
        (Poisson(poisson=0.3), False),
    ],
    ids=lambda value: getattr(value, "id", value),
)
def test_cases_with_a_history_of_their_own_are_solved_side_by_side(effect, apart, monkeypatch):
    believed = rig()
    asked = []

    def solved(worked, cases, **options):
        asked.append([case.name for case in cases])
        return solve_cases(worked, cases, **options)

    monkeypatch.setattr(predictor, "solve_cases", solved)
    one, two = (Predictor(believed, SignalLayout(believed), threads=n).solved([effect], threads=1) for n in (1, 2))
    names = list(believed.cases)
    assert sorted(asked[-len(names) :]) == sorted([name] for name in names) if apart else asked[-1] == names
    for name in names:
        np.testing.assert_array_equal(one.fields[name], two.fields[name])


def test_a_modulus_that_an_effect_states_is_the_one_that_is_fitted():
    believed = replace(rig(), effects=(Stiffness(young_kpa=25.0), Poisson(poisson=0.3)))
    own = _own_modulus(believed)
    assert own.effects == (Poisson(poisson=0.3),)
    assert own.material.young_array.mean() == 25.0
    assert own.young_std == pytest.approx(believed.young_std * 2.5)
    assert _own_modulus(own) is own


def test_an_extended_model_is_diagnosed_with_a_modulus_that_may_move():
    diagnosis = tr.diagnose(replace(rig(), effects=(Stiffness(young_kpa=25.0),)), keep=False)
    target, found = diagnosis.details.target, diagnosis.details.search.base
    assert target.bench.young == 25.0
    # Forces of noise alone fit a softer body.
    assert found.x[0] < -0.01
    assert np.abs(found.jacobian[0]).max() > 0.0
    # They are no larger than their noise: no modulus follows.
    assert [one.kind for one in diagnosis.suspicions] == ["silent"]
    assert not [effect for effect in diagnosis.extended.effects if isinstance(effect, Stiffness)]
    assert "stiffness" not in [finding.id for finding in diagnosis.findings]


def test_a_hypothesis_that_grows_without_bounds_is_left_out(monkeypatch):
    believed = rig()
    bench = Bench(believed, SignalLayout(believed))
    plain = make_bank(bench, keep=False)["poisson"]
    wild = replace(plain[0], label="wild", columns=1e45 * np.ones_like(plain[0].columns, float))
    none = replace(plain[0], label="none", columns=np.full_like(plain[0].columns, np.nan))
    large = replace(plain[0], label="large", columns=1e3 * plain[0].columns)
    monkeypatch.setattr(type(CAUSES["poisson"]), "variants", lambda self, bench: [*plain, wild, none, large])
    found = make_bank(bench, keep=False)["poisson"]
    assert [one.label for one in found] == [*(one.label for one in plain), "large"]
    assert all(np.isfinite(one.columns).all() for one in found)
    monkeypatch.setattr(type(CAUSES["poisson"]), "variants", lambda self, bench: [wild])
    assert "poisson" not in make_bank(bench, keep=False)


def test_a_recording_is_compared_with_elements_that_do_not_lock(monkeypatch):
    class SeenError(Exception):
        pass

    def suspected(*_, element, **__):
        raise SeenError(element)

    monkeypatch.setattr(readings, "responses", suspected)
    plain = replace(rig(), simulated=Simulated("plain", "tet4", tables_sha256="0" * 64))
    for experiment, element, expected in (
        (rig(), None, "tet4-averaged"), (rig(), "tet10", "tet10"), (plain, None, "tet4"),
    ):  # fmt: skip
        with pytest.raises(SeenError, match=f"^{expected}$"):
            tr.diagnose(experiment, element=element, keep=False)


@pytest.mark.parametrize("threads", [1, 2])
def test_warnings_of_the_believed_model_are_noted_where_a_prediction_is_asked_for(threads):
    stiff = replace(rig(), material=Material(young=10.0, poisson=0.48), effects=(RELAXATION,))
    bench = Bench(stiff, SignalLayout(stiff), threads=threads)
    with recorded() as record, pytest.warns(LockingWarning) as given:
        bench.predictor.predict(threads=1)
    assert [text for text in record.warnings if "lock" in text]
    assert threads > 1 or given[0].filename == __file__


def test_no_thread_is_left_by_predictions():
    before = active_count()
    slow = replace(rig(), effects=(RELAXATION,))
    bench = Bench(slow, SignalLayout(slow), threads=2)
    bench.changes([[Poisson(poisson=0.3)], [Poisson(poisson=0.35)]])
    assert active_count() == before


def test_what_is_kept_of_a_rig_for_further_histories_is_never_advanced():
    slow = replace(rig(), effects=(RELAXATION,))
    bench = Bench(slow, SignalLayout(slow), threads=1)
    bench.changes([[Relaxation(g=(share,), tau_s=(2.0,))] for share in (0.2, 0.3)])
    rigs = bench.predictor._rigs
    assert rigs
    for (_, pads, _), kept in rigs.items():
        # Before the times of all cases: a history that has begun cannot go there.
        kept.rig.advance(-1.0, np.full((len(pads), 3), np.nan))


def test_memory_that_a_step_has_freed_is_given_back_before_the_next(monkeypatch):
    steps, given = [], []
    monkeypatch.setattr(run, "give_back", lambda: given.append(len(steps)))
    tr.diagnose(rig(), keep=False, progress=steps.append)
    assert given == list(range(len(steps)))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep no freed memory to give back")
def test_freed_memory_is_given_back_by_the_call_of_the_c_library(monkeypatch):
    called = []

    class Library:
        def malloc_trim(self, pad):
            called.append(pad)

    assert ctypes.CDLL(None).malloc_trim
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Library())
    run.give_back()
    assert called == [0]
