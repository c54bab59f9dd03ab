"""A live registration outlives its peers, takes the newest frame, and its recording gives the same answers."""

import dataclasses
import gc
import io
import itertools
import json
import struct
import time

import numpy as np
import pytest

from support.openigtlink import BODY, NAMES, SIT, FastEngine, Peer, eventually, point_message, serving
from tissuereg.errors import FormatError
from tissuereg.io.recordings import read_recording
from tissuereg.io.recordings.table import LiveRow, TableRecorder, recorder
from tissuereg.live import LiveServer, LiveSettings
from tissuereg.live.answers import answer_digest
from tissuereg.live.frames import FirstFrame, Gathering, Intake, LiveFrame
from tissuereg.live.keeper import Keeper
from tissuereg.live.peers import Peers, shown
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


def transforms(names, times=(0.0,)):
    """Messages of tools by the names of their transforms, at some moments; the kth is at (k, 0, 0)."""
    return [
        (now + 0.001 * k, packed("TRANSFORM", name, transform_packed(pose((k, 0, 0)))))
        for now in times
        for k, name in enumerate(names)
    ]


def test_several_transforms_of_a_tool_are_in_several_frames_and_not_mixed():
    names = [f"{NAMES[0]}ToTracker", f"{NAMES[0]}ToReference", NAMES[1], NAMES[2]]
    gathering, frames = gathered(transforms(names, (0.0, 1.0, 2.0)))
    assert {one.name for one in gathering.events} == {"SEVERAL_FRAMES"}
    assert len(gathering.events) == 2  # each transform once
    assert "'P1ToReference' is in another frame than 'P1ToTracker'" in gathering.events[0].text
    for frame in frames[1:]:
        assert np.isnan(frame.places[0]).all()


def test_tools_in_different_frames_are_not_mixed_unless_one_frame_is_named():
    names = [f"{NAMES[0]}ToTracker", f"{NAMES[1]}ToReference", f"{NAMES[2]}ToReference"]
    gathering, frames = gathered([*transforms(names), *transforms(names, (1.0, 2.0))])
    assert frames == []
    # The first came before another frame was known.
    only = gathering.flush(2.0, always=True)
    assert np.isfinite(only[0].places).all(axis=1).tolist() == [True, False, False]
    assert not gathering.waits
    assert "'P2ToReference' is in another frame than 'P1ToTracker'" in gathering.events[0].text
    gathering, frames = gathered([*transforms(names, (0.0, 1.0)), *transforms(names[:2], (1.5,))], tools_in="Reference")
    assert [np.isfinite(frame.places).all(axis=1).tolist() for frame in frames] == [[False, True, True]] * 2
    assert "'P1ToTracker' does not end in ToReference" in gathering.events[0].text
    # One that stopped long ago is forgotten.
    later = transforms([f"{name}ToReference" for name in NAMES], (100.0, 100.5))
    _, frames = gathered([*transforms(names[:1]), *later])
    assert np.isfinite(frames[-1].places).all()


class Disk(io.BytesIO):
    """A file that takes half of what is written while `full`."""

    full = False

    def write(self, data):
        if not self.full:
            return super().write(data)
        super().write(data[: len(data) // 2])
        raise OSError(28, "No space left on device")


def test_a_frame_for_which_there_was_no_room_leaves_no_hole_before_the_next_one():
    disk = Disk()
    kept, whole = TableRecorder(disk, NAMES), TableRecorder(Disk(), NAMES)
    for k in range(3):
        row = LiveRow(0.1 * k, SIT, 0.1 * k)
        disk.full = k == 1
        if k == 1:
            with pytest.raises(OSError, match="No space left"):
                kept.add(row)
        else:
            kept.add(row)
            whole.add(row)
    assert disk.getvalue() == whole._handle.getvalue()


@pytest.mark.parametrize("tools_in", [None, "Tracker"])
def test_made_up_frames_hold_no_memory(tools_in):
    names = [f"{NAMES[0]}ToFrame{k}" for k in range(1200)]
    gathering, _ = gathered(transforms(names), tools_in=tools_in)
    assert len(gathering._into) == (1000 if tools_in is None else 0)
    assert len(gathering.events) <= 1000
    # The newest are the ones that are known.
    assert names[-1].removeprefix(f"{NAMES[0]}To") in gathering._into or tools_in


def test_a_status_of_one_tool_hides_that_tool_alone():
    poses = {f"{name}ToTracker": pose(place) for name, place in zip(NAMES, SIT, strict=True)}

    def seen(metadata):
        message = packed("TDATA", "Tracker", tools_packed(poses), 0.0, metadata)
        return np.isfinite(gathered([(0.0, message)])[1][0].places).all(axis=1).tolist()

    for key in ("P2ToTrackerTransformStatus", "P2TransformStatus", "p2Status", "P2.Status", "P2_status"):
        assert seen({key: "INVALID"}) == [True, False, True], key
    assert seen({"P2Status": "OK", "P3ToTrackerTransformStatus": "missing"}) == [True, True, False]
    assert seen({"OtherTransformStatus": "INVALID", "Statuses": "INVALID"}) == [True, True, True]
    for key in ("TransformStatus", "Status"):
        assert seen({key: "INVALID"}) == [False, False, False], key
    # A pose of one tool that is none hides it alone, too.
    poses["P1ToTracker"][0, 0] = np.nan
    assert seen({}) == [False, True, True]


def turned_and_moved(places):
    """The same places in a tracker's own frame, turned about z by 30 degrees and moved."""
    c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    return places @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + np.array([500.0, -200.0, 1000.0])


def test_the_first_whole_frame_aligns_the_tracker_s_frame_and_it_stays_so():
    lost = turned_and_moved(SIT)
    lost[1] = np.nan
    mirrored = turned_and_moved(np.vstack([SIT, [7.0, 3.0, 1.0]])) * (-1, 1, 1)
    sit = np.vstack([SIT, [7.0, 3.0, 1.0]])
    names = (*NAMES, "P4")
    gathering = Gathering(Intake(names, alignment=FirstFrame(sit)), LiveSettings())

    def frame(places, now, called=names):
        return gathering.take(opened(point_message(places, called)), now)[0]

    whole = turned_and_moved(sit)
    for places, called, why in ((lost, NAMES, "all markers must be seen once"), (mirrored, names, "left-handed")):
        one = frame(places, 1.0 + len(gathering.events), called)
        assert not one.ready
        assert np.isnan(one.places).all()
        assert gathering.events[-1].name == "NOT_ALIGNED"
        assert why in gathering.events[-1].text
    one = frame(whole, 5.0)
    assert one.ready
    np.testing.assert_allclose(one.places, sit, atol=1e-3)
    assert gathering.events[-1].name == "ALIGNED"
    assert "rms residual" in gathering.events[-1].text
    # What moves later moves in the body's frame: nothing is aligned again.
    up = np.array([0.0, 0.0, 7.0])
    np.testing.assert_allclose(frame(turned_and_moved(sit + up), 6.0).places, sit + up, atol=1e-3)
    assert len(gathering.events) == 3


def test_peers_are_told_of_the_alignment_and_every_answer_states_its_residual():
    off = SIT + np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    with serving(intake=Intake(NAMES, alignment=FirstFrame(SIT))) as server:
        peer = Peer(server.address)
        peer.send(point_message(turned_and_moved(SIT)[:2], NAMES[:2]))
        assert status_in(peer.read("STATUS").content).name == "NOT_ALIGNED"
        first = answer(peer)
        assert first["trusted"] is False
        assert first["alignment_rms_mm"] is None
        assert status_in(peer.read("STATUS").content).name == "NOT_REGISTERED"
        peer.send(point_message(turned_and_moved(off)))
        status = status_in(peer.read("STATUS").content)
        said = answer(peer)
        peer.close()
    assert (status.code, status.name) == (1, "ALIGNED")
    assert server.alignment.rms_mm == said["alignment_rms_mm"] > 0.01
    assert f"rms residual {server.alignment.rms_mm:.3g} mm" in status.text
    assert any("was aligned to the body's by the first frame" in text for text in server.said)
    assert first.keys() == said.keys()


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
        failed = answer(peer)
        assert status_in(peer.read("STATUS").content).name == "NOT_REGISTERED"
        peer.send(point_message(SIT))
        good = answer(peer)
        assert good["trusted"] is True
        # Whoever reads answers finds the same fields in all.
        assert failed.keys() == good.keys()
        assert failed["latency_ms"] is failed["step_ms"] is failed["markers_used"] is failed["markers_rms_mm"] is None
        assert (failed["trusted"], failed["stale"], failed["targets"]) == (False, False, {})
        assert 0.0 < good["step_ms"] < good["latency_ms"]
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
        eventually(lambda: server.peer_counts.peers == 2)
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
    assert server.peer_counts.refused == 1


@pytest.mark.parametrize("kind", ["POINT", "IMAGE"])
def test_idle_peers_give_way_to_a_new_one_and_those_that_send_do_not(kind):
    data = point_message(SIT) if kind == "POINT" else packed("IMAGE", "x", bytes(10))
    with serving(most_peers=3, idle_s=0.4) as server:
        busy = Peer(server.address)  # the first of all, so that nothing but what it sends keeps it
        eventually(lambda: server.peer_counts.peers == 1)
        idle = []
        while len(idle) < 2:
            idle.append(Peer(server.address))
            eventually(lambda: server.peer_counts.peers == 1 + len(idle))
        assert Peer(server.address).gone()  # none has been idle for long
        assert server.peer_counts.refused == 1
        first = idle[0].socket.getsockname()[1]
        time.sleep(0.5)
        busy.send(data)
        eventually(lambda: server.counts.skipped + server.counts.registered == 1)
        new = Peer(server.address)
        assert idle[0].gone()  # the one that was silent for longest
        assert server.peer_counts.displaced == 1
        busy.send(point_message(SIT))
        for peer in (busy, new, idle[1]):
            assert answer(peer)["trusted"] is True
        for peer in (*idle, busy, new):
            peer.close()
    gave_way = [text for text in server.said if "gives way to" in text]
    assert gave_way[0].startswith(f"127.0.0.1:{first} gives way to 127.0.0.1:")
    assert "it has sent nothing for" in gave_way[0]
    assert not any(f"127.0.0.1:{first} is gone" in text for text in server.said)


class FakeWriter:
    """A connection that nobody reads: its address, and the bytes that wait."""

    def __init__(self, name, waiting=0):
        self.name, self.waiting, self.aborted = name, waiting, False
        self.transport = self

    def get_extra_info(self, _, default=None):
        return (self.name, 1)

    def get_write_buffer_size(self):
        return self.waiting

    def abort(self):
        self.aborted = True


def test_a_peer_that_we_called_never_gives_way():
    said = []
    peers = Peers(LiveSettings(most_peers=2, idle_s=10.0), said.append)
    writers = [FakeWriter("plus", waiting=9), FakeWriter("viewer"), FakeWriter("new"), FakeWriter("late")]
    peers.admit(writers[0], 0.0, called=True)
    peers.admit(writers[1], 5.0)
    assert peers.admit(writers[2], 14.0) is None
    assert peers.admit(writers[2], 15.0) is not None
    assert [one.aborted for one in writers] == [False, True, True, False]
    assert "viewer:1 gives way to new:1: it has sent nothing for 10 s" in said
    assert peers.admit(writers[3], 20.0) is None
    assert sum("refused" in text for text in said) == 1
    assert (peers.counts.refused, peers.counts.displaced) == (2, 1)


def test_a_peer_that_does_not_read_gives_way_before_one_that_is_silent_for_longer():
    with serving(most_peers=2, idle_s=0.2) as server:
        silent = Peer(server.address)
        eventually(lambda: server.peer_counts.peers == 1)
        deaf = Peer(server.address)
        eventually(lambda: server.peer_counts.peers == 2)
        there = list(server._peers._there)
        there[1].writer.write(bytes(20_000_000))  # more than the system takes for it
        assert there[1].unread > 0
        time.sleep(0.25)
        new = Peer(server.address)
        eventually(lambda: server.peer_counts.displaced == 1)
        assert there[1].gave_way
        assert not there[0].gave_way
        for peer in (silent, deaf, new):
            peer.close()


def test_addresses_with_colons_have_brackets():
    assert shown(("::1", 18944)) == "[::1]:18944"
    assert shown(("127.0.0.1", 1)) == "127.0.0.1:1"


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
        while server.peer_counts.unsent == 0 and count < 3000:
            peer.send(point_message(SIT))
            answer(peer)
            count += 1
        assert server.peer_counts.unsent > 0
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
    assert server.peer_counts.peers == 2


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
        full = False

        def add(self, row):
            raise OSError(28, "No space left on device")

    with serving(recorder=FullDisk()) as server:
        peer = Peer(server.address)
        for k in range(3):
            peer.send(point_message(SIT, time_s=3.0 + 0.1 * k))
            # The first answer is sent before it is recorded.
            assert answer(peer)["recorded"] is (k == 0)
            if k == 0:
                assert status_in(peer.read("STATUS").content).name == "TRUSTED"
                status = status_in(peer.read("STATUS").content)
        peer.close()
    assert (status.code, status.name) == (11, "NOT_RECORDED")
    assert "No space left on device" in status.text
    assert server.counts.registered == 3
    assert server.counts.spoilt == 0
    assert sum("No space left on device" in text for text in server.said) == 1


def test_a_recording_that_is_full_ends_with_a_whole_frame(tmp_path):
    with recorder(tmp_path / "live.csv", NAMES) as kept:
        kept._left = 4 * len(NAMES) * 30
        for k in range(20):
            kept.add(LiveRow(float(k), SIT, float(k), registered=True))
        assert kept.full
    found = read_recording(tmp_path / "live.csv")
    assert 0 < len(found) < 20
    assert np.isfinite(found.places).all()


def test_peers_are_told_when_the_recording_is_full(tmp_path):
    with recorder(tmp_path / "live.csv", NAMES) as kept, serving(recorder=kept) as server:
        peer = Peer(server.address)
        statuses, room = [], kept._left
        for k in range(3):
            if k == 1:
                eventually(lambda: kept._left < room)  # the first frame is written after its answer is sent
                kept._left = 0
            peer.send(point_message(SIT, time_s=3.0 + 0.1 * k))
            assert answer(peer)["recorded"] is (k < 2)
            statuses.append(status_in(peer.read("STATUS").content).name)
            if k == 1:
                statuses.append(status_in(peer.read("STATUS").content).name)
        peer.close()
    assert statuses == ["TRUSTED", "TRUSTED", "NOT_RECORDED", "TRUSTED"]
    assert sum("it has its largest size: frames from now on" in text for text in server.said) == 1
    assert len(read_recording(tmp_path / "live.csv")) == 1


def kept_rows(act):
    """Return the rows that a keeper hands on in what `act` does with it and frames 0, 1, 2 ..."""

    class Kept(list):
        full = False
        add = list.append

    rows = Kept()
    keeper = Keeper(rows, LiveSettings(most_waiting=3), pytest.fail)
    act(keeper, [LiveFrame(float(k), SIT, 0.5 + k) for k in range(9)], rows)
    keeper.close()
    return [(row.time_s, row.registered, row.answer) for row in rows]


def test_frames_wait_for_the_answer_to_the_one_before_and_are_recorded_in_the_order_of_time():
    def act(keeper, frames, rows):
        keeper.taken(frames[0])
        keeper.dropped(frames[1])
        assert rows == []
        keeper.answered("a")
        assert len(rows) == 2
        keeper.dropped(frames[2])
        assert len(rows) == 3
        keeper.taken(frames[3])
        keeper.answered("failed")
        keeper.taken(frames[4])  # its answer does not come any more

    said = [(0.0, True, "a"), (1.0, False, ""), (2.0, False, ""), (3.0, True, "failed"), (4.0, False, "")]
    assert kept_rows(act) == said


def test_an_answer_that_does_not_come_holds_few_frames():
    def act(keeper, frames, rows):
        keeper.taken(frames[0])
        for frame in frames[1:6]:
            keeper.dropped(frame)
        assert len(rows) == 6
        keeper.answered("late")

    assert kept_rows(act) == [(0.0, True, ""), *((float(k), False, "") for k in range(1, 6))]


def test_a_recording_holds_arrival_senders_names_and_answers(tmp_path):
    path = tmp_path / "live.csv"
    with recorder(path, NAMES) as kept, serving(recorder=kept, gather_s=5.0) as server:
        peer = Peer(server.address)
        for name in NAMES:
            peer.send(packed("TRANSFORM", f"{name}ToTracker", transform_packed(pose((1, 2, 3)))))
        answer(peer)
        peer.send(point_message([(np.nan, 0, 0)] * 3))
        answer(peer)
        eventually(lambda: server.counts.failed + server.counts.registered == 2)
        peer.close()
    found = read_recording(path)
    assert found.received[1] > found.received[0] > 0.0
    assert len(found.answers[0]) == 16
    assert found.answers[0] != found.answers[1]
    again = found.only(np.array([False, True]))
    assert again.answers == found.answers[1:]
    assert again.received[0] == found.received[1]
    lines = path.read_text().splitlines()
    assert lines[0].endswith("registered,received_s,answer,sent_as")
    assert [line.rpartition(",")[2] for line in lines[1:]] == ["P1ToTracker", "P2ToTracker", "P3ToTracker", "", "", ""]


def test_a_digest_tells_answers_apart_that_differ_in_the_last_bit():
    result = FastEngine().step(SIT + 1.0, 0.0)
    same, other = answer_digest(result, 1.5), answer_digest(result, np.nextafter(1.5, 2.0))
    assert answer_digest(FastEngine().step(SIT + 1.0, 0.0), 1.5) == same != other
    changed = []
    for name, at in (("mean", 1), ("covariance", (0, 0))):
        target = result.targets["lesion"]
        array = getattr(target, name).copy()
        array[at] = np.nextafter(array[at], 1e9)
        result.targets["lesion"] = dataclasses.replace(target, **{name: array})
        changed.append(answer_digest(result, 1.5))
        result.targets["lesion"] = target
    result.displacement[3, 2] = np.nextafter(result.displacement[3, 2], 1e9)
    changed.append(answer_digest(result, 1.5))
    result.trust.ok = not result.trust.ok
    changed.append(answer_digest(result, 1.5))
    assert len({same, other, *changed}) == 6


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
