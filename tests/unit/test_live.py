"""A live registration outlives its peers, takes the newest frame, and its recording gives the same answers."""

import gc
import itertools
import json
import struct
import time

import numpy as np
import pytest

from support.openigtlink import BODY, NAMES, SIT, FastEngine, Peer, eventually, point_message, serving
from tissuereg.errors import FormatError
from tissuereg.io.recordings import read_recording
from tissuereg.io.recordings.table import recorder
from tissuereg.live import LiveServer, LiveSettings
from tissuereg.live.frames import Gathering, Intake
from tissuereg.live.protocol import (
    HEADER_BYTES,
    header_of,
    message_of,
    packed,
    points_in,
    status_in,
    surface_in,
    text_in,
    tools_packed,
    transform_packed,
)

RAS = np.array([-1.0, -1.0, 1.0])


def pose(place):
    found = np.eye(4)
    found[:3, 3] = place
    return found


def opened(data):
    header = header_of(data)
    return message_of(header, data[HEADER_BYTES:])


def answer(peer):
    return json.loads(text_in(peer.read("STRING").content))


# --- what comes in, what goes out ---


def test_points_are_registered_and_answered_in_ras():
    moved = SIT + np.array([1.0, 2.0, 3.0])
    with serving(intake=Intake(NAMES, frame="LPS")) as server:
        peer = Peer(server.address)
        # As Slicer sends them; and more points than markers.
        peer.send(point_message([*(moved * RAS), (0, 0, 0)], [*NAMES, "other"], time_s=50.0))
        surface, targets = surface_in(peer.read("POLYDATA").content), points_in(peer.read("POINT").content)
        said, status = answer(peer), status_in(peer.read("STATUS").content)
        peer.close()
    nodes = np.unique(BODY.surface)
    np.testing.assert_allclose(surface.points, (BODY.nodes[nodes] + np.array([1, 2, 3])) * RAS, atol=1e-4)
    np.testing.assert_allclose(surface.scalars["std_mm"], np.linspace(0.1, 1.0, BODY.n_nodes)[nodes], atol=1e-6)
    corners = np.array(surface.polygons)
    np.testing.assert_array_equal(nodes[corners], BODY.surface)
    assert [one.name for one in targets] == ["lesion"]
    np.testing.assert_allclose(targets[0].place, [-11.0, -12.0, 13.0], atol=1e-5)
    # The 90 % region of a Gaussian in three dimensions has 2.5003 standard deviations.
    assert targets[0].radius == pytest.approx(3.0 * 2.5003, abs=1e-3)
    np.testing.assert_allclose(said["targets"]["lesion"]["region90_radii_mm"], 2.5003 * np.array([1, 2, 3]), atol=1e-3)
    assert said["trusted"] is True
    assert said["stale"] is False
    assert said["latency_ms"] > 0.0
    assert (status.code, status.name) == (1, "TRUSTED")
    assert server.counts.registered == 1
    assert any("'other' is no marker of the reference (P1, P2, P3 ...)" in one for one in server.said)


def test_the_spread_is_computed_now_and_then_and_says_from_which_frame_it_is():
    engine = FastEngine()
    nodes = np.unique(BODY.surface)
    with serving(engine, spread_s=0.25, jump_s=1000.0) as server:
        peer = Peer(server.address)
        of = []
        for k in range(6):
            peer.send(point_message(SIT, time_s=50.0 + 0.1 * k))
            surface = surface_in(peer.read("POLYDATA").content)
            said = answer(peer)
            of.append(round(said["time_s"] - said["spread_of_s"], 3))
            # The first spread counts until the second is there.
            assert surface.scalars["std_mm"][0] == pytest.approx((1 if k < 4 else 2) * 0.1 + 0.0 * nodes[0])
        peer.close()
    assert of == [0.0, 0.1, 0.2, 0.3, 0.1, 0.2]
    assert engine.spreads == 2


def test_tools_make_a_frame_and_an_invalid_one_is_not_seen():
    engine = FastEngine()
    intake = Intake(NAMES, offsets={"P1": np.array([0.0, 0.0, -5.0])})
    with serving(engine, intake=intake, gather_s=5.0) as server:
        peer = Peer(server.address)
        for name, place in zip(NAMES, SIT, strict=True):
            status = {"TransformStatus": "INVALID" if name == "P2" else "OK"}
            content = transform_packed(pose(place))
            peer.send(packed("TRANSFORM", f"{name}ToTracker", content, 7.0, status))
        said = answer(peer)
        peer.send(
            packed(
                "TDATA", "Tracker", tools_packed({name: pose(place) for name, place in zip(NAMES, SIT, strict=True)})
            )
        )
        answer(peer)
        peer.close()
    first, second = (places for _, places in engine.seen)
    np.testing.assert_allclose(first, [SIT[0] - (0, 0, 5), [np.nan] * 3, SIT[2]])
    np.testing.assert_allclose(second, SIT - np.array([[0, 0, 5], [0, 0, 0], [0, 0, 0]]))
    assert said["trusted"] is False
    assert said["reasons"] == ["noise: a marker is missing"]


def test_a_tool_that_does_not_come_does_not_hold_the_others_up():
    engine = FastEngine()
    with serving(engine, gather_s=0.02) as server:
        peer = Peer(server.address)
        for name in NAMES[:2]:
            peer.send(packed("TRANSFORM", name, transform_packed(pose((1, 2, 3)))))
        eventually(lambda: engine.seen)
        peer.close()
    assert np.isfinite(engine.seen[0][1]).all(axis=1).tolist() == [True, True, False]


def gathered(messages, **changed):
    """Return the frames of messages that come at given times: (time of arrival, message)."""
    gathering = Gathering(Intake(NAMES, **changed), LiveSettings())
    frames = [frame for now, data in messages for frame in gathering.take(opened(data), now)]
    return gathering, frames


def test_a_sender_s_clock_that_differs_jumps_or_stands_still():
    sent = [1e9, 1e9 + 0.1, 1e9 + 0.1, 1e9 + 0.05, 1e9 - 500.0, 1e9 - 499.9]
    came = [5.0, 5.2, 5.3, 5.4, 5.5, 5.6]
    gathering, frames = gathered([(now, point_message(SIT, time_s=s)) for now, s in zip(came, sent, strict=True)])
    times = [frame.time_s for frame in frames]
    # Time between frames is the sender's; one that repeats or goes back has the time of its arrival.
    np.testing.assert_allclose(times[:2], [5.0, 5.1], atol=1e-6)
    assert all(b > a for a, b in itertools.pairwise(times))
    assert len(times) == 6
    assert gathering.resets == 1
    # Without a clock the time of arrival counts.
    _, plain = gathered([(now, point_message(SIT)) for now in (1.0, 1.5, 1.5)])
    assert [frame.time_s for frame in plain] == [1.0, 1.5]


def test_names_are_joined_by_number_or_order():
    others = ["F-1", "F-2", "F-3"]
    for match, names in (("number", others[::-1]), ("order", ["a", "b", "c"])):
        places = SIT[::-1] if match == "number" else SIT
        _, frames = gathered([(0.0, point_message(places, names))], match=match)
        np.testing.assert_allclose(frames[0].places, SIT)
    gathering, frames = gathered([(0.0, point_message(SIT, others))])
    assert frames == []
    assert list(gathering.unknown) == others
    # Many strange names do not keep those of markers from being known.
    strange = [(0.1 * k, point_message(SIT, [f"{k}-{i}" for i in range(3)])) for k in range(1, 400)]
    gathering, frames = gathered([*strange, (99.0, point_message(SIT))])
    assert len(frames) == 1
    assert len(gathering.unknown) == 1000
    with pytest.raises(FormatError, match="an offset must be of a marker"):
        LiveServer(FastEngine(), Intake(NAMES, offsets={"Q": np.zeros(3)}))


def test_a_marker_is_known_however_many_strangers_came_before():
    many = LiveSettings().most_names + 10
    gathering, frames = gathered(
        [(0.0, point_message(np.zeros((many, 3)), [f"Unlabeled {i}" for i in range(many)])), (1.0, point_message(SIT))]
    )
    np.testing.assert_allclose(frames[-1].places, SIT)
    assert len(gathering.unknown) == many - 10


def test_a_name_commands_no_terminal():
    gathering, _ = gathered([(0.0, point_message(SIT, ["\x1b[2J", "\u202egnp", "a\nb"]))])
    assert list(gathering.unknown) == ["\ufffd[2J", "\ufffdgnp", "a\ufffdb"]


def test_the_offset_of_a_tool_is_found_by_the_marker_s_name_whatever_the_sender_calls_it():
    offsets = {NAMES[1]: np.array([0.0, 0.0, 5.0])}
    messages = [
        (0.0, packed("TRANSFORM", f"Tool_{i}ToTracker", transform_packed(pose(p)))) for i, p in enumerate(SIT, 1)
    ]
    _, frames = gathered(messages, match="number", offsets=offsets)
    np.testing.assert_allclose(frames[0].places, SIT + np.array([[0, 0, 0], [0, 0, 5], [0, 0, 0]]))


@pytest.mark.parametrize("turn", [np.zeros((3, 3)), 2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0])])
def test_a_pose_whose_turn_is_none_is_not_seen(turn):
    given = [pose(place) for place in SIT]
    given[1][:3, :3] = turn
    names = [f"{name}ToTracker" for name in NAMES]
    messages = [(0.0, packed("TRANSFORM", name, transform_packed(one))) for name, one in zip(names, given, strict=True)]
    places = gathered(messages)[1][0].places
    assert np.isnan(places[1]).all()
    assert np.isfinite(places[[0, 2]]).all()


def test_points_of_which_it_is_not_clear_which_they_are_are_refused():
    gathering = Gathering(Intake(NAMES, match="order"), LiveSettings())
    for points in (SIT[1:], [*SIT, SIT[0]]):  # the first was hidden: the others would move up
        with pytest.raises(FormatError, match="must be as many as the markers, 3"):
            gathering.take(opened(point_message(points, [""] * len(points))), 0.0)
    with pytest.raises(FormatError, match="each marker must stand once"):
        gathered([(0.0, point_message([*SIT, SIT[0] + 50.0], [*NAMES, NAMES[0]]))])


def test_several_transforms_of_a_tool_are_in_several_frames_and_not_mixed():
    names = [f"{NAMES[0]}ToTracker", f"{NAMES[0]}ToReference", NAMES[1], NAMES[2]]
    messages = [(0.1 * k, packed("TRANSFORM", name, transform_packed(pose((k, 0, 0))))) for k, name in enumerate(names)]
    gathering, frames = gathered([*messages, *((now + 1.0, data) for now, data in messages), *messages[2:]])
    assert names[1] in gathering.unknown
    for frame in frames[1:]:
        assert np.isnan(frame.places[0]).all()


# --- peers ---


def test_it_outlives_peers_that_break_the_protocol():
    good = point_message(SIT)
    huge = good[:42] + struct.pack(">QQ", 2**63, 0)
    with serving(partial_s=1.0) as server:
        other = Peer(server.address)
        for broken in (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" + bytes(60), huge, bytes(200), b"\xff" * 58):
            peer = Peer(server.address)
            peer.send(broken)
            assert peer.gone()
            peer.close()
        half = Peer(server.address)
        half.send(good[:100])
        assert half.gone()  # its rest did not come in time
        vanished = Peer(server.address)
        vanished.send(good[:70])
        vanished.close()
        wrong = Peer(server.address)
        wrong.send(good[:-1] + b"\1" + packed("IMAGE", "x", bytes(200_000)) + good)
        assert answer(wrong)["trusted"] is True  # the good one behind a spoilt one and one of another type
        assert answer(other)["trusted"] is True
        other.close()
        wrong.close()
        assert server.counts.skipped == 1
        assert server.counts.spoilt == 6
        assert any("a message must have at most" in text for text in server.said)


def test_a_frame_that_breaks_the_engine_does_not_end_it():
    class Fragile(FastEngine):
        def step(self, measured_mm, time_s):
            if np.isnan(measured_mm).all():
                message = "zero-size array"
                raise ValueError(message)
            return super().step(measured_mm, time_s)

    with serving(Fragile()) as server:
        peer = Peer(server.address)
        # Farther than any tracker sees, no number, and beyond single precision: none was seen.
        with np.errstate(over="ignore"):
            peer.send(point_message([SIT[0] + 1e5, (np.nan, 0, 0), (np.inf, 0, 0)]))
        assert status_in(peer.read("STATUS").content).name == "NOT_REGISTERED"
        peer.send(point_message(SIT))
        assert answer(peer)["trusted"] is True
        peer.close()
    assert (server.counts.failed, server.counts.registered) == (1, 1)
    assert any("this is a bug" in text for text in server.said)


def test_the_newest_frame_is_registered_and_a_slow_engine_drops_the_others():
    engine = FastEngine(takes=0.05)
    with serving(engine) as server:
        peer = Peer(server.address)
        for k in range(1000):
            peer.send(point_message(SIT + np.array([0.0, 0.0, 0.001 * k]), time_s=100.0 + 0.001 * k))
        eventually(lambda: server.counts.received == 1000)
        eventually(lambda: server.counts.registered + server.counts.dropped == 1000)
        peer.close()
    assert server.counts.dropped > 900
    np.testing.assert_allclose(engine.seen[-1][1], SIT + np.array([0.0, 0.0, 0.999]), atol=1e-4)


def test_two_clients_get_the_answers_and_one_too_many_is_refused():
    with serving(most_peers=2) as server:
        one, two = Peer(server.address), Peer(server.address)
        eventually(lambda: server.counts.peers == 2)
        assert Peer(server.address).gone()
        one.send(point_message(SIT))
        assert answer(one) == answer(two)
        one.close()
        eventually(lambda: any("is gone" in text for text in server.said))
        three = Peer(server.address)
        # What was answered last is told to those who come later.
        assert answer(three)["trusted"] is True
        three.close()
        two.close()
    assert server.counts.refused == 1


def test_an_old_answer_is_marked_stale_until_a_new_frame_comes():
    with serving(stale_s=0.1) as server:
        peer = Peer(server.address)
        peer.send(point_message(SIT))
        assert answer(peer)["stale"] is False
        assert answer(peer)["stale"] is True
        assert status_in(peer.read("STATUS").content).name == "STALE"
        late = Peer(server.address)
        assert answer(late)["stale"] is True
        peer.send(point_message(SIT))
        assert answer(peer)["stale"] is False
        peer.close()
        late.close()


def test_a_peer_that_does_not_read_costs_neither_memory_nor_time():
    with serving(most_unsent_bytes=20_000) as server:
        deaf, peer = Peer(server.address), Peer(server.address)
        count = 0
        while server.counts.unsent == 0 and count < 3000:
            peer.send(point_message(SIT))
            answer(peer)
            count += 1
        assert server.counts.unsent > 0
        deaf.close()
        peer.send(point_message(SIT))
        assert answer(peer)["trusted"] is True
        peer.close()


def test_it_connects_to_a_peer_that_comes_and_goes():
    import asyncio
    import socket

    listener = socket.create_server(("127.0.0.1", 0))
    engine = FastEngine()
    server = LiveServer(engine, Intake(NAMES), LiveSettings(retry_s=0.02))

    def tracker():
        for _ in range(2):
            peer, _ = listener.accept()
            peer.sendall(point_message(SIT))
            peer.recv(1000)
            peer.close()

    async def both():
        await asyncio.gather(server.run(None, listener.getsockname()[:2], frames=2), asyncio.to_thread(tracker))

    asyncio.run(both())
    listener.close()
    assert len(engine.seen) == 2
    assert server.counts.peers == 2


def test_a_client_of_another_make_is_understood_and_understands():
    pyigtl = pytest.importorskip("pyigtl")
    engine = FastEngine()
    with serving(engine, gather_s=5.0) as server:
        client = pyigtl.OpenIGTLinkClient(host="127.0.0.1", port=server.address[1])
        eventually(client.is_connected)
        client.send_message(pyigtl.PointMessage(positions=(SIT + 1.0).tolist(), names=list(NAMES), device_name="F"))
        targets = client.wait_for_message("Targets", timeout=5)
        assert targets.names == ["lesion"]
        np.testing.assert_allclose(targets.positions, [[11.0, 11.0, 11.0]])
        for name, place in zip(NAMES, SIT, strict=True):
            client.send_message(pyigtl.TransformMessage(pose(place), device_name=f"{name}ToTracker"))
        eventually(lambda: len(engine.seen) == 2)
        client.stop()
    np.testing.assert_allclose(engine.seen[1][1], SIT)
    assert server.counts.spoilt == 0


# --- recordings ---


def test_a_recording_holds_every_frame_and_which_were_registered(tmp_path):
    engine = FastEngine(takes=0.02)
    path = tmp_path / "live.csv"
    with recorder(path, NAMES) as kept:
        with serving(engine, recorder=kept) as server:
            peer = Peer(server.address)
            for k in range(20):
                peer.send(point_message([SIT[0] + k, SIT[1], (np.nan, 0, 0)], time_s=3.0 + 0.01 * k))
            eventually(lambda: server.counts.registered + server.counts.dropped == 20)
            peer.close()
        assert not path.exists()  # it takes its name when it is whole
    found = read_recording(path)
    assert found.names == NAMES
    assert len(found) == 20
    assert found.registered.sum() == server.counts.registered == len(engine.seen)
    taken = found.only(found.registered)
    for (time_s, places), (again_s, again) in zip(engine.seen, taken, strict=True):
        assert again_s == time_s
        np.testing.assert_array_equal(again, places)


def test_a_recording_that_cannot_be_written_ends_neither_the_server_nor_a_peer():
    class FullDisk:
        def add(self, time_s, places, *, registered):
            raise OSError(28, "No space left on device")

    with serving(recorder=FullDisk()) as server:
        peer = Peer(server.address)
        for k in range(3):
            peer.send(point_message(SIT, time_s=3.0 + 0.1 * k))
            answer(peer)
        peer.close()
    assert server.counts.registered == 3
    assert server.counts.spoilt == 0
    assert sum("No space left on device" in text for text in server.said) == 1


def test_a_recording_that_is_full_ends_with_a_whole_frame(tmp_path):
    with recorder(tmp_path / "live.csv", NAMES) as kept:
        kept._left = 4 * len(NAMES) * 30
        for k in range(20):
            kept.add(float(k), SIT, registered=True)
        assert kept.full
    found = read_recording(tmp_path / "live.csv")
    assert 0 < len(found) < 20
    assert np.isfinite(found.places).all()


# --- soak ---


def test_five_hundred_frames_leave_nothing_behind():
    with serving(FastEngine(keeps=2)) as server:
        peer = Peer(server.address)

        def frames(count):
            for _ in range(count):
                peer.send(point_message(SIT, time_s=time.time()))
                answer(peer)
            gc.collect()
            return len(gc.get_objects())

        before = frames(100)
        after = frames(400)
        peer.close()
    assert server.counts.registered == 500
    # One object a frame would be four hundred.
    assert after - before < 100
    assert len(server.latencies_s) == 500
