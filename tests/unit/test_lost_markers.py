"""Measured places that are no measurements: they count as not seen, and this is said."""

import numpy as np
import pytest

import tissuereg as tr
from misuse.events import BODIES, good
from support.meshes import block
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import LostMarkerWarning, MarkerError
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.readings.lost import lost
from tissuereg.tracking.watch import Watch

MESH = block(cells=(2, 2, 3))
PLACES = MESH.nodes[np.setdiff1d(MESH.surface_nodes, MESH.fixed_nodes)][::2]
NAMES = tuple(f"M{i + 1}" for i in range(len(PLACES)))
STD, FRAME_S = 0.1, 0.025
SENTINELS = {
    "zeros": (0.0, 0.0, 0.0),
    "negative zeros": (-0.0, 0.0, -0.0),
    "minus 9999.99": (-9999.99,) * 3,
    "the same in the other frame": (9999.99, 9999.99, -9999.99),
    "the same near the body": (99.0, -99.0, 99.0),
    "a bad float": (-3.697314e28,) * 3,
    "minus one": (-1.0,) * 3,
    "one coordinate of them": (12.0, 8.0, -3.697314e28),
}


@pytest.fixture(scope="module")
def leaning():
    """True displacement of the block, pushed at its top, mm."""
    forces = np.where(MESH.nodes[:, 2:] == 40.0, [15.0, 5.0, -5.0], 0.0)
    return tr.simulate(MESH, tr.Load(forces=forces), tr.Material(10.0, 0.4)).displacement


def measured(field, seed, places=PLACES):
    seen = MarkerObservation(MESH, places, NAMES[: len(places)])
    return places + seen.predict(field[seen.nodes]) + STD * np.random.default_rng(seed).standard_normal(places.shape)


def contacts():
    few = ContactSettings(n_chains=4, n_chains_first=4, n_kept=2, powers=(0.1, 1.0, 1.0), n_draws=4)
    body = tr.Body(MESH, tr.Material(10.0, 0.4))
    settings = tr.RegisterSettings(threads=1, contacts=few)
    return tr.Registrar(body, tr.Markers(PLACES, std=STD), None, {"deep": (15.0, 10.0, 20.0)}, settings=settings)


@pytest.mark.parametrize("digits", [1, 3, 12])
@pytest.mark.parametrize("value", SENTINELS.values(), ids=SENTINELS)
def test_what_is_written_for_a_marker_that_was_not_seen_is_no_measurement(leaning, value, digits):
    places = np.round(measured(leaning, 1), digits)
    for row in (0, 5):
        places[row] = value
    found = lost(tr.Markers(PLACES, places, STD), MESH.extent)
    assert set(found) == {"M1", "M6"}
    assert all(why.startswith("lost: ") for why in found.values())


def test_one_place_for_several_markers_is_none_of_theirs(leaning):
    places = measured(leaning, 2)
    places[[2, 4, 7]] = 12.345, 6.789, 3.21
    assert set(lost(tr.Markers(PLACES, places, STD), MESH.extent)) == {"M3", "M5", "M8"}
    places[7] = PLACES[7]  # two are a marker that is listed twice, which is said elsewhere
    assert lost(tr.Markers(PLACES, places, STD), MESH.extent) == {}


def test_a_marker_that_is_found_beside_the_body_was_measured(leaning):
    places = measured(leaning, 4)
    places[0] += 60.0, 0.0, 0.0
    assert lost(tr.Markers(PLACES, places, STD), MESH.extent) == {}


def test_a_marker_that_sits_at_the_origin_may_be_measured_there(leaning):
    places, reference = measured(leaning, 3), PLACES.copy()
    reference[0], places[0] = (0.1, 0.0, -0.1), 0.0
    assert lost(tr.Markers(reference, places, STD), MESH.extent) == {}


def test_coarse_numbers_are_equal_by_chance():
    rng = np.random.default_rng(4)
    reference = np.round(rng.uniform(0.0, 4.0, (40, 3)))
    places = np.round(reference + rng.uniform(-2.0, 2.0, (40, 3)))
    assert lost(tr.Markers(reference, places, 0.2), 40.0) == {}


def test_another_unit_is_no_loss(leaning):
    assert lost(tr.Markers(PLACES, 1000.0 * measured(leaning, 5), STD), MESH.extent) == {}


@pytest.mark.parametrize("value", [0.0, -1.0, 1e300])
def test_all_markers_may_be_lost_at_once(value):
    places = np.full_like(PLACES, value)
    assert set(lost(tr.Markers(PLACES, places, STD), MESH.extent)) == set(NAMES)
    places[:, 1] *= 0.4  # a place of its own: the origin of a tool, as every marker
    assert set(lost(tr.Markers(PLACES, places, STD), MESH.extent)) == set(NAMES)


@pytest.mark.parametrize("body", BODIES)
def test_good_events_lose_no_marker(body):
    for number in range(40):
        event = good(body, number)
        assert lost(event.markers(), event.mesh().extent) == {}


@pytest.mark.parametrize("name", ["zeros", "a bad float"])
def test_contacts_are_found_as_if_the_marker_had_not_been_seen(leaning, name):
    places = measured(leaning, 6)
    places[3] = np.nan
    without = contacts().register(places)
    places[3] = SENTINELS[name]
    with pytest.warns(LostMarkerWarning, match="marker M4 counts as not seen"):
        found = contacts().register(places)
    assert np.array_equal(found.displacement, without.displacement)
    assert found.trust == without.trust
    ((marker, why),) = found.markers.dropped
    assert marker == "M4"
    assert why.startswith("lost: ")
    assert set(found.unseen) == {"M4"}


def test_a_trained_model_does_not_see_a_lost_marker_either():
    event = make_event(seed=0)
    names, places = event.markers.names, event.markers.measured.copy()
    places[4] = 0.0
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", {"lesion": LESION_MM})
    given = event.markers
    with pytest.warns(LostMarkerWarning):
        found = registrar.register(tr.Markers(given.reference, places, given.axis_std, names))
    assert found.markers.dropped == ((names[4], "lost: measured at exactly 0, 0, 0"),)


def test_where_all_are_lost_the_error_says_why(leaning):
    places = np.full_like(PLACES, -9999.99)
    places[:4] = measured(leaning, 7)[:4]
    places[:4] = np.nan
    with pytest.raises(MarkerError, match=r"all 13 are missing; M5 \(lost: the same number"):
        contacts().register(places)


def test_lost_markers_must_be_those_of_the_registrar(leaning):
    with pytest.raises(MarkerError, match="`lost` must name markers"):
        contacts().register(measured(leaning, 8), lost={"Q1": "gone"})


def test_a_pose_that_is_repeated_while_others_move_is_not_seen(leaning):
    tracker = tr.Tracker(contacts())
    before = measured(leaning, 9)
    tracker.step(before, 0.0)
    now = measured(1.1 * leaning, 10)
    now[[2, 5]] = before[[2, 5]]
    with pytest.warns(LostMarkerWarning):
        found = tracker.step(now, FRAME_S)
    assert [name for name, why in found.markers.dropped if "to the last digit" in why] == ["M3", "M6"]
    # A frame that comes twice is no loss.
    assert tracker.step(now, 2 * FRAME_S).markers.dropped == ()


def test_a_jump_is_not_seen_until_the_marker_is_near_the_body_again(leaning):
    tracker = tr.Tracker(contacts())
    tracker.step(measured(leaning, 11), 0.0)
    for number in (1, 2, 3):
        away = measured(leaning, 11 + number)
        away[6] += 31.0, 25.0, 21.0
        with pytest.warns(LostMarkerWarning):
            found = tracker.step(away, number * FRAME_S)
        assert [(name, "jump" in why) for name, why in found.markers.dropped] == [("M7", True)]
    assert tracker.step(measured(leaning, 15), 4 * FRAME_S).markers.dropped == ()


def test_a_body_that_is_moved_as_a_whole_and_a_pause_are_no_jumps(leaning):
    places = measured(leaning, 16)
    watch = Watch(tr.Markers(PLACES, std=STD))
    body = places, np.zeros(len(places))
    watch.registered(places, 0.0, {}, tr.Markers(PLACES, places, STD), body)
    assert watch.lost(places + [90.0, -50.0, 40.0] + 0.01 * places, FRAME_S) == {}
    far = measured(leaning, 17)
    far[6] += 40.0
    assert list(watch.lost(far, FRAME_S)) == ["M7"]
    assert watch.lost(far, 1.0) == {}
