"""A tracker: the loop over frames, what is carried on, what is dropped."""

import gc
import threading
import weakref
from functools import cache

import numpy as np
import pytest

import tissuereg as tr
from support.answers import told
from support.meshes import block
from tissuereg._base.choices import RESTARTS
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import ArgumentError, MarkerError
from tissuereg.registration import inputs
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.tracking import FemPhysics, TablePhysics, fitted, fitted_prior

MESH = block(cells=(2, 2, 3))
BELIEVED, TRUE = tr.Material(young=10.0, poisson=0.4), tr.Material(young=8.0, poisson=0.45)
STD, FRAME_S = 0.1, 0.025
PLACES = MESH.nodes[np.setdiff1d(MESH.surface_nodes, MESH.fixed_nodes)][::2]
TARGETS = {"deep": (15.0, 10.0, 20.0)}


def pushed(share):
    return tr.Load(forces=np.where(MESH.nodes[:, 2:] == 40.0, [60.0 * share, 0.0, -20.0 * share], 0.0))


def truly_pushed(share):
    extra = np.where((MESH.nodes[:, 2:] == 40.0) & (MESH.nodes[:, 1:2] > 5.0), [0.0, 25.0 * share, 0.0], 0.0)
    return tr.Load(forces=pushed(share).forces + extra)


def physics(**changed):
    return FemPhysics(MESH, BELIEVED, pushed, **{"threads": 1, "tolerance": 1e-8, **changed})


@cache
def prior():
    return fitted_prior(MESH, BELIEVED, largest_mm=3.0, n_events=60, n_latent=12, threads=1)


@cache
def truth(share):
    return FemPhysics(MESH, TRUE, truly_pushed, threads=1, tolerance=1e-8).field(share)


@cache
def registrar():
    settings = tr.RegisterSettings(threads=1, smoother=tr.SmootherSettings(n_members=60))
    return tr.Registrar(MESH, tr.Markers(PLACES, std=STD), prior(), TARGETS, settings=settings)


def contact_registrar():
    return tr.Registrar(tr.Body(MESH, BELIEVED), tr.Markers(PLACES, std=STD), None, TARGETS, settings=quick_contacts())


def measured(share, rng):
    seen = MarkerObservation(MESH, PLACES, tuple(f"M{i + 1}" for i in range(len(PLACES))))
    moved = seen.predict(truth(share)[seen.nodes])
    return PLACES + moved + STD * rng.standard_normal(moved.shape)


def square_error(result, share):
    """Return the mean square distance of the nodes and that of the target, mm^2."""
    inner = TargetObservation(MESH, TARGETS)
    deep = np.asarray(TARGETS["deep"]) + inner.predict(truth(share)[inner.nodes])[0]
    nodes = ((result.displacement - truth(share)) ** 2).sum(axis=1).mean()
    return np.array([nodes, ((result.target("deep").mean - deep) ** 2).sum()])


def quick_contacts():
    few = ContactSettings(n_chains=4, n_chains_first=4, n_chains_on=4, n_kept=2, powers=(0.1, 1.0, 1.0), n_draws=4)
    return tr.RegisterSettings(threads=1, contacts=few)


def said(result):
    return told(result, "work")


class Time:
    """A clock that moves when it is told to."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s

    def wait(self, seconds):
        self.now_s += seconds


def test_a_first_frame_is_that_of_the_registrar_bit_for_bit():
    seen = measured(1.0, np.random.default_rng(0))
    alone = registrar().register(seen, physics().field(1.0))
    tracker = tr.Tracker(registrar(), simulator=physics())
    found = tracker.step(seen, 0.0, actuator=1.0)
    assert said(found) == said(alone)
    assert np.array_equal(found.displacement, alone.displacement)
    assert tracker.last.gain == 1.0


@pytest.mark.parametrize("restart", RESTARTS)
def test_on_a_still_body_tracking_is_not_worse_than_frame_by_frame(restart):
    tracked, alone = [], []
    field = physics().field(1.0)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        tracker = tr.Tracker(registrar(), simulator=physics(), restart=restart)
        for k in range(6):
            seen = measured(1.0, rng)
            tracked.append(square_error(tracker.step(seen, FRAME_S * k, actuator=1.0), 1.0))
            alone.append(square_error(registrar().register(seen, field), 1.0))
    # Over 36 frames: body and target.
    assert (np.mean(tracked, axis=0) <= np.mean(alone, axis=0)).all()


def test_without_the_temporal_prior_and_from_the_reference_every_frame_is_that_of_the_registrar():
    rng = np.random.default_rng(1)
    tracker = tr.Tracker(registrar(), simulator=physics(), restart="reference", temporal=False)
    for k, share in enumerate((0.4, 0.7, 1.0)):
        seen = measured(share, rng)
        alone = registrar().register(seen, physics().field(share))
        assert said(tracker.step(seen, FRAME_S * k, actuator=share)) == said(alone)


def test_a_moving_body_is_followed_closer_than_it_is_simulated():
    rng, solver = np.random.default_rng(2), physics()
    tracker = tr.Tracker(registrar(), simulator=solver)
    tracked, simulated = [], []
    for k, share in enumerate(np.linspace(0.1, 1.0, 10)):
        result = tracker.step(measured(share, rng), FRAME_S * k, actuator=share)
        tracked.append(square_error(result, share)[0])
        simulated.append(((solver.field(share) - truth(share)) ** 2).sum(axis=1).mean())
    assert np.sqrt(np.mean(tracked)) < 0.5 * np.sqrt(np.mean(simulated))


def test_forces_hold_the_registered_shape_when_the_actuator_stops():
    rng = np.random.default_rng(3)
    tracker = tr.Tracker(registrar(), simulator=physics(), restart="forces")
    for k, share in enumerate((0.5, 1.0)):
        stopped = tracker.step(measured(share, rng), FRAME_S * k, actuator=share)
    for k in range(2, 4):
        tracker.step(measured(1.0, rng), FRAME_S * k, actuator=1.0)
        # The start of the solve is its answer, to its tolerance.
        assert np.abs(tracker.last.simulation - stopped.displacement).max() < 1e-4
    assert tracker.fallbacks == 0


def test_a_table_needs_no_solver():
    shares = np.linspace(0.0, 1.0, 5)
    table = TablePhysics(shares, [physics().field(share) for share in shares])
    rng = np.random.default_rng(4)
    tracker = tr.Tracker(registrar(), simulator=table, restart="forces")
    for k, share in enumerate((0.3, 0.6, 0.9)):
        assert tracker.step(measured(share, rng), FRAME_S * k, actuator=share).trust is not None
    assert tracker.last.simulation.shape == (MESH.n_nodes, 3)


def test_a_fitted_prior_is_made_once_for_all_frames_and_markers(monkeypatch):
    made = []
    plain = fitted.random_changes
    monkeypatch.setattr(fitted, "random_changes", lambda *a, **k: made.append(1) or plain(*a, **k))
    model = fitted_prior(MESH, BELIEVED, largest_mm=3.0, n_events=20, n_latent=6, threads=1)
    tracker = tr.Tracker(
        tr.Registrar(MESH, PLACES, model, TARGETS, settings=tr.RegisterSettings(threads=1)), simulator=physics()
    )
    rng = np.random.default_rng(5)
    for k, share in enumerate((0.2, 0.5, 0.8, 1.0)):
        seen = measured(share, rng)
        seen[k] = np.nan
        tracker.step(seen, FRAME_S * k, actuator=share)
    assert made == [1]


def test_the_first_frame_after_a_reset_is_examined_for_misreadings_as_the_first_of_all(monkeypatch):
    examined, plain = [], inputs.suspect
    monkeypatch.setattr(inputs, "suspect", lambda *given: examined.append(1) or plain(*given))
    tracker, rng = tr.Tracker(registrar(), simulator=physics()), np.random.default_rng(5)
    counts = []
    for k, share in enumerate((0.2, 0.3, 0.2, 0.3)):
        if k == 2:
            tracker.reset()  # as after the frame by which a live registration gets warm
        assert tracker.step(measured(share, rng), FRAME_S * k, actuator=share).trust.ok
        counts.append(len(examined))
    assert counts == [1, 1, 2, 2]


def test_markers_come_and_go_and_a_frame_without_any_leaves_the_tracker_as_it_was():
    rng = np.random.default_rng(6)
    tracker = tr.Tracker(registrar(), simulator=physics())
    tracker.step(measured(1.0, rng), 0.0, actuator=1.0)
    half = measured(1.0, rng)
    half[::2] = np.nan
    result = tracker.step(half, FRAME_S, actuator=1.0)
    assert len(result.markers.used) == len(PLACES) // 2
    assert set(result.unseen) == {f"M{i + 1}" for i in range(0, len(PLACES), 2)}
    before = tracker.last
    with pytest.raises(MarkerError, match="must have been seen"):
        tracker.step(np.full_like(PLACES, np.nan), 2 * FRAME_S, actuator=1.0)
    assert tracker.last is before
    assert tracker.step(measured(1.0, rng), 2 * FRAME_S, actuator=1.0).markers.used == registrar().markers.names


def test_residuals_and_volume_ratios_are_those_of_the_filtered_answer():
    from tissuereg.body.mesh import det_f

    rng = np.random.default_rng(7)
    tracker = tr.Tracker(registrar(), simulator=physics())
    for k in range(3):
        seen = measured(1.0, rng)
        result = tracker.step(seen, FRAME_S * k, actuator=1.0)
    assert tracker.last.gain < 1.0
    observed = registrar().attached.observed
    places = PLACES + observed.predict(result.displacement[observed.nodes])
    own = PLACES + observed.predict(tracker.last.alone.displacement[observed.nodes])
    for i, name in enumerate(result.markers.used):
        moved = result.markers.residual_mm[name] - tracker.last.alone.markers.residual_mm[name]
        # Rounding.
        assert np.allclose(moved, own[i] - places[i], rtol=0.0, atol=1e-12)
    assert result.min_det_f == det_f(MESH, result.displacement).min()


def test_a_frame_that_is_not_later_than_the_last_is_refused():
    rng = np.random.default_rng(8)
    tracker = tr.Tracker(registrar(), simulator=physics())
    tracker.step(measured(1.0, rng), 1.0, actuator=1.0)
    for time_s in (1.0, 0.5, np.nan):
        with pytest.raises(ArgumentError, match="time_s"):
            tracker.step(measured(1.0, rng), time_s, actuator=1.0)
    tracker.reset()
    assert tracker.last is None
    tracker.step(measured(1.0, rng), 0.5, actuator=1.0)


def test_update_is_step_with_the_time_first():
    seen = measured(1.0, np.random.default_rng(9))
    one, other = (tr.Tracker(registrar(), simulator=physics()) for _ in range(2))
    assert said(one.update(0.0, seen, 1.0)) == said(other.step(seen, 0.0, actuator=1.0))


def test_an_actuator_without_a_simulator_and_options_beside_a_registrar_are_refused():
    seen = measured(1.0, np.random.default_rng(10))
    with pytest.raises(ArgumentError, match="simulator"):
        tr.Tracker(registrar()).step(seen, 0.0, actuator=1.0)
    with pytest.raises(ArgumentError, match="`targets` must be left out"):
        tr.Tracker(registrar(), targets=TARGETS)
    with pytest.raises(ArgumentError, match="restart"):
        tr.Tracker(registrar(), restart="never")
    with pytest.raises(MarkerError, match="reference_mm"):
        tr.Tracker(MESH)


def test_a_newer_frame_takes_the_place_of_one_that_waits_and_this_is_counted():
    rng = np.random.default_rng(11)
    tracker = tr.Tracker(registrar(), simulator=physics())
    assert tracker.poll() is None
    for k in range(3):
        tracker.push(measured(1.0, rng), FRAME_S * k, actuator=1.0)
    frame = tracker.poll()
    assert (frame.time_s, frame.skipped, tracker.dropped) == (2 * FRAME_S, 2, 2)
    assert tracker.poll() is None
    tracker.push(measured(1.0, rng), 3 * FRAME_S, actuator=1.0)
    assert tracker.poll().skipped == 0
    assert tracker.dropped == 2


def test_frames_pushed_by_another_thread_are_registered_or_counted():
    rng = np.random.default_rng(12)
    tracker = tr.Tracker(registrar(), simulator=physics())
    frames = [measured(1.0, rng) for _ in range(8)]

    def camera():
        for k, frame in enumerate(frames):
            tracker.push(frame, FRAME_S * (k + 1), actuator=1.0)

    thread = threading.Thread(target=camera)
    thread.start()
    registered = []
    while thread.is_alive() or not registered or registered[-1].time_s < FRAME_S * 8:
        found = tracker.poll()
        registered += [] if found is None else [found]
    thread.join()
    assert len(registered) + tracker.dropped == 8


@pytest.mark.parametrize(
    ("cost_s", "kept", "dropped"),
    [
        (0.01, [0, 1, 2, 3, 4, 5, 6, 7], 0),
        # Two and a half frames each: of those that came meanwhile the newest is next.
        (0.0625, [0, 2, 5, 7], 4),
        (10.0, [0, 7], 6),
    ],
)
def test_a_recording_is_replayed_at_its_rate_and_the_newest_frame_is_next(cost_s, kept, dropped):
    clock = Time()

    def simulator(share):
        clock.now_s += cost_s
        return share * np.ones_like(MESH.nodes) * (MESH.nodes[:, 2:] > 0.0)

    rng = np.random.default_rng(13)
    tracker = tr.Tracker(registrar(), simulator=simulator, restart="reference")
    frames = [(FRAME_S * k, measured(1.0, rng), 1.0) for k in range(8)]
    # The first frame of a tracker simulates once, as does each later one from the reference, whose last one is kept.
    found = list(tracker.run(frames, clock=clock, wait=clock.wait))
    assert [round(frame.time_s / FRAME_S) for frame in found] == kept
    assert tracker.dropped == dropped == sum(frame.skipped for frame in found)
    # Alone on its clock a frame waits only for those before it.
    for frame, before in zip(found, [None, *found], strict=False):
        free_s = frame.time_s if before is None else max(frame.time_s, before.time_s + before.latency_s)
        assert frame.latency_s == pytest.approx(free_s + cost_s - frame.time_s)


def test_a_replay_goes_on_after_a_frame_that_cannot_be_registered_if_it_is_told_where_to_say_so():
    clock, rng, told = Time(), np.random.default_rng(15), []
    frames = [(FRAME_S * k, measured(1.0, rng)) for k in range(3)]
    frames[1][1][:] = np.nan
    tracker = tr.Tracker(registrar())
    found = list(tracker.run(frames, failed=lambda *what: told.append(what), clock=clock, wait=clock.wait))
    assert [frame.time_s for frame in found] == [0.0, 2 * FRAME_S]
    assert [time_s for time_s, _ in told] == [FRAME_S]
    assert isinstance(told[0][1], MarkerError)
    tracker.reset()
    with pytest.raises(MarkerError, match="must have been seen"):
        list(tracker.run(frames, clock=clock, wait=clock.wait))


def test_chains_that_go_on_do_not_repeat_their_random_numbers():
    alone = contact_registrar()
    seen, places = measured(1.0, np.random.default_rng(16)), []
    for _ in range(2):
        result, path = None, []
        for _ in range(8):
            result = alone.register(seen, after=result)
            path.append(result.target("deep").mean)
        places.append(path)
    # The same from the same seed; and where one set of random numbers, again and again, would end, they go on.
    assert np.array_equal(*places)
    assert len(np.unique(np.round(places[0][3:], 9), axis=0)) == 5


def test_contacts_go_on_from_the_last_frame_with_less_work():
    rng = np.random.default_rng(14)
    alone = contact_registrar()
    tracker = tr.Tracker(contact_registrar(), temporal=False)
    work = {"tracked": [], "alone": []}
    errors = {"tracked": [], "alone": []}
    for k, share in enumerate((0.8, 0.85, 0.9, 0.95, 1.0, 1.0)):
        seen = measured(share, rng)
        for name, result in (("tracked", tracker.step(seen, FRAME_S * k)), ("alone", alone.register(seen))):
            work[name].append([result.work[count] for count in ("passes", "right_hand_sides")])
            errors[name].append(square_error(result, share))
    tracked, again = (np.sum(work[name][1:], axis=0) for name in ("tracked", "alone"))
    assert tracked[0] < again[0]
    assert tracked[1] < again[1]
    # The same model and data, other draws.
    assert np.mean(errors["tracked"]) < 1.5 * np.mean(errors["alone"])


@pytest.mark.parametrize("made", [contact_registrar, registrar], ids=["contacts", "model"])
def test_a_frame_is_forgotten_when_later_ones_are_there(made):
    tracker, rng, alone = tr.Tracker(made()), np.random.default_rng(8), []
    for number in range(4):
        tracker.update(number * FRAME_S, measured(0.25 * (number + 1), rng))
        alone.append(weakref.ref(tracker.last.alone))
    gc.collect()
    assert [one() is None for one in alone] == [True, True, True, False]


def test_contacts_are_carried_on_in_place_of_the_registered_shape():
    rng = np.random.default_rng(16)
    alone = contact_registrar()
    solver = physics()
    tracker = tr.Tracker(alone, simulator=solver)
    for k, share in enumerate((0.8, 1.0)):
        result = tracker.step(measured(share, rng), FRAME_S * k, actuator=share)
        # The simulation alone, to the solver's tolerance; the contacts explain what it lacks.
        assert np.abs(tracker.last.simulation - solver.field(share)).max() < 1e-4
        assert tracker.last.widening == 1.0
    assert np.sqrt(square_error(result, 1.0)[0]) < np.sqrt(((solver.field(1.0) - truth(1.0)) ** 2).sum(axis=1).mean())


def test_contacts_of_a_frame_are_of_no_use_after_a_jump_and_all_places_are_searched():
    rng = np.random.default_rng(15)
    alone = contact_registrar()
    tracker = tr.Tracker(contact_registrar(), temporal=False)
    tracker.step(measured(0.1, rng), 0.0)
    seen = measured(1.0, rng)
    result = tracker.step(seen, FRAME_S)
    alone = alone.register(seen)
    assert result.markers.after_rms_mm < 2.0 * alone.markers.after_rms_mm


def test_a_frame_that_goes_on_is_as_near_to_equilibrium_as_the_change_asks():
    registrar, rng = contact_registrar(), np.random.default_rng(3)
    result = registrar.register(measured(0.5, rng))
    for share in (0.52, 0.54):
        result = registrar.register(measured(share, rng), after=result)
        fit = result.draw.fit
        columns = fit.columns
        exact = columns.body.simulator.solve(
            columns.load(fit.state.coefficients), result.body.material, springs=columns.springs, tolerance=1e-10
        )
        off = np.linalg.norm(exact.all_displacement - fit.state.displacement, axis=1).max()
        assert 0.0 < off < 5e-4 * np.linalg.norm(fit.state.displacement, axis=1).max()
