"""``tissuereg live``: what it registers is what ``track`` registers from its recording."""

import contextlib
import json
import socket
import threading

import numpy as np
import pytest

import tissuereg as tr
from support.files import run_json
from support.meshes import block
from support.openigtlink import Peer, point_message
from support.small_model import SMALL_MODEL
from tissuereg.cli import live
from tissuereg.cli.track import _replay_lines
from tissuereg.io.meshes import write_vtu
from tissuereg.live.protocol import text_in

BODY = tr.phantom.phantom_mesh("small")
HELD = np.setdiff1d(BODY.surface_nodes, BODY.fixed_nodes)[::60]
PLACES = BODY.nodes[HELD]
NAMES = [f"P{i + 1}" for i in range(len(PLACES))]


@pytest.fixture
def inputs(tmp_path):
    write_vtu(tmp_path / "body.vtu", BODY)
    rows = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(NAMES, PLACES.tolist(), strict=True)]
    (tmp_path / "reference.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(rows))
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,5,5,20\n")
    return tmp_path


def words(folder):
    files = [folder / "body.vtu", "--reference", folder / "reference.csv", "--targets", folder / "targets.csv"]
    return [*files, "--model", SMALL_MODEL, "--members", 40, "--frame", "LPS", "--quiet"]


def feeding(monkeypatch, sent, heard, names=NAMES, bursts=()):
    """Send frames (time, places in RAS) to the server once it listens, one answer after the other.

    `bursts`: numbers of frames after which the next one is sent without waiting for an answer.
    """
    told = threading.Event()
    at = []

    def listening(self, *_, ready=None, **more):
        def begun(address):
            at.append(address)
            told.set()

        return served(self, *_, ready=begun, **more)

    served = live_server().run
    monkeypatch.setattr(live_server(), "run", listening)

    def feed():
        assert told.wait(20.0)
        peer = Peer(at[0], timeout_s=30.0)
        with contextlib.suppress(EOFError, ConnectionError):  # the server may end before the last answer is read
            for k, (time_s, places) in enumerate(sent):
                peer.send(point_message(places, names, time_s=time_s))
                if k in bursts:
                    continue
                heard.append(json.loads(text_in(peer.read("STRING").content)))
                while heard[-1].get("stale"):
                    heard[-1] = json.loads(text_in(peer.read("STRING").content))
        peer.close()

    thread = threading.Thread(target=feed, daemon=True)
    thread.start()
    return thread


def live_server():
    from tissuereg.live import LiveServer

    return LiveServer


def test_a_recording_of_a_live_registration_is_tracked_with_the_same_answers(inputs, capsys, monkeypatch):
    lean = [np.c_[0.02 * k * BODY.nodes[HELD, 2], np.zeros((len(HELD), 2))] for k in range(4)]
    sent = [(100.0 + 0.1 * k, (PLACES + field) * (-1, -1, 1)) for k, field in enumerate(lean)]
    sent[2][1][1] = np.nan
    heard = []
    thread = feeding(monkeypatch, sent, heard)
    code, said, _ = run_json(capsys, "live", *words(inputs), "--listen", "127.0.0.1:0", "--frames", 4, "--record",
                             inputs / "live.csv")  # fmt: skip
    thread.join(20.0)
    assert code in (0, 4)
    assert said["registered"] == 4
    assert said["latency_ms"]["median"] > 0.0
    files = [inputs / "body.vtu", inputs / "live.csv", *words(inputs)[1:]]
    _, tracked, _ = run_json(capsys, "track", *files, "--out", inputs / "out")
    assert len(tracked["frames"]) == 4
    for now, later in zip(heard, tracked["frames"], strict=True):
        assert now["time_s"] == later["time_s"]
        x, y, z = later["targets"]["lesion"]["mean_mm"]
        assert now["targets"]["lesion"]["mean_mm"] == [-x, -y, z]
        assert now["targets"]["lesion"]["region90_radii_mm"] == later["targets"]["lesion"]["region90_radii_mm"]
        assert now["trusted"] == later["trust"]["ok"]
    assert tracked["frames"][2]["markers_used"] == len(NAMES) - 1


def replayed(capsys, inputs, *more, file="live.csv", out="again"):
    files = [inputs / "body.vtu", "--replay", inputs / file, *words(inputs)[1:]]
    return run_json(capsys, "track", *files, "--out", inputs / out, *more)


def test_a_replay_takes_the_frames_that_were_taken_and_knows_whether_the_answers_are_the_same(
    inputs, capsys, monkeypatch
):
    lean = [np.c_[0.01 * k * BODY.nodes[HELD, 2], np.zeros((len(HELD), 2))] for k in range(8)]
    sent = [(100.0 + 0.1 * k, (PLACES + field) * (-1, -1, 1)) for k, field in enumerate(lean)]
    sent[1][1][:] = np.nan  # a frame that cannot be registered
    sent[2][1][1] = np.nan
    heard = []
    thread = feeding(monkeypatch, sent, heard, bursts=(4, 5))
    code, said, _ = run_json(capsys, "live", *words(inputs), "--listen", "127.0.0.1:0", "--seconds", 60, "--record",
                             inputs / "live.csv", "--surface", "none", "--frames", 5)  # fmt: skip
    thread.join(20.0)
    assert code == 4
    assert said["failed"] == 1
    kept = tr.read_recording(inputs / "live.csv")
    assert len(kept) == said["received"]
    assert kept.registered.sum() == said["registered"] + said["failed"]
    assert kept.answers.count("failed") == 1
    code, again, _ = replayed(capsys, inputs)
    assert code == 4  # a frame could not be registered, then as now
    assert again["replay"] == {"compared": said["registered"] + 1, "different_s": []}
    taken = {one["time_s"]: one for one in again["frames"]}
    assert set(taken) | {again["failed"][0]["time_s"]} == set(kept.times[kept.registered].tolist())
    for one in heard:
        if one["markers_used"]:
            x, y, z = taken[one["time_s"]]["targets"]["lesion"]["mean_mm"]
            assert one["targets"]["lesion"]["mean_mm"] == [-x, -y, z]
    # Other options, another place in the last digit: it is told which answers differ.
    _, other, _ = replayed(capsys, inputs, "--seed", 7)
    assert set(other["replay"]["different_s"]) == set(taken)
    text = (inputs / "live.csv").read_text()
    row = next(line for line in text.splitlines() if line.startswith(f"{again['frames'][-1]['time_s']!r},P3,"))
    cells = row.split(",")
    cells[2] = repr(np.nextafter(float(cells[2]), 1e9).item())
    (inputs / "changed.csv").write_text(text.replace(row, ",".join(cells)))
    code, changed, _ = replayed(capsys, inputs, file="changed.csv")
    assert code == 4
    assert changed["replay"]["different_s"] == [again["frames"][-1]["time_s"]]


def test_a_replay_is_the_same_without_a_model_and_after_the_first_frame_aligned(tmp_path, capsys, monkeypatch):
    body = block()
    write_vtu(tmp_path / "body.vtu", body)
    sit = body.nodes[np.setdiff1d(body.surface_nodes, body.fixed_nodes)][::9]
    names = [f"P{i}" for i in range(len(sit))]
    rows = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(names, sit.tolist(), strict=True)]
    (tmp_path / "sit.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(rows))
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,15,10,20\n")
    given = ["--reference", tmp_path / "sit.csv", "--targets", tmp_path / "targets.csv", "--quiet"]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    lean = [np.c_[0.01 * k * sit[:, 2], np.zeros((len(sit), 2))] for k in (0, 0, 1, 2, 3)]
    sent = [(100.0 + 0.1 * k, (sit + by) @ turn.T + (300.0, 20.0, 1000.0)) for k, by in enumerate(lean)]
    sent[0][1][2] = np.nan  # not whole: it aligns nothing
    heard = []
    thread = feeding(monkeypatch, sent, heard, names)
    code, said, _ = run_json(capsys, "live", tmp_path / "body.vtu", *given, "--listen", "127.0.0.1:0", "--frames", 4,
                             "--align", "first", "--record", tmp_path / "live.csv")  # fmt: skip
    thread.join(20.0)
    assert code == 4
    assert (said["registered"], said["failed"]) == (4, 1)
    assert said["alignment"]["rms_mm"] < 0.001
    np.testing.assert_allclose(said["alignment"]["rotation"], turn.T, atol=1e-5)
    assert [one["alignment_rms_mm"] is None for one in heard] == [True, False, False, False, False]
    code, again, errors = run_json(capsys, "track", tmp_path / "body.vtu", "--replay", tmp_path / "live.csv", *given,
                                   "--out", tmp_path / "out")  # fmt: skip
    assert again["replay"] == {"compared": 4, "different_s": []}
    assert "1 frame left out, which 'live' did not register" in errors
    for one, later in zip(heard[1:], again["frames"], strict=True):
        assert one["targets"]["lesion"]["mean_mm"] == later["targets"]["lesion"]["mean_mm"]


def test_a_replay_is_of_a_live_recording_and_stands_alone(inputs, capsys):
    row = "0,P1,1,2,3"
    (inputs / "plain.csv").write_text(f"time_s,marker,x_mm,y_mm,z_mm\n{row}\n")
    (inputs / "none.csv").write_text(f"time_s,marker,x_mm,y_mm,z_mm,registered\n{row},0\n")
    code, said, _ = replayed(capsys, inputs, file="plain.csv")
    assert (code, "must be a recording of 'tissuereg live'" in said["message"]) == (2, True)
    code, said, _ = replayed(capsys, inputs, file="none.csv")
    assert (code, "must hold a frame that was registered" in said["message"]) == (2, True)
    for more in (["--align", "first"], ["--offset", "P1 0 0 1"], ["--match", "number"], ["--live"], ["--rate", "9"]):
        code, said, _ = replayed(capsys, inputs, *more)
        assert (code, f"must come without {more[0]}" in said["message"]) == (2, True)
    code, said, _ = run_json(capsys, "track", *words(inputs), "--out", inputs / "out")
    assert (code, "MARKERS or --replay must be given" in said["message"]) == (2, True)
    code, said, _ = run_json(capsys, "track", inputs / "body.vtu", inputs / "plain.csv", "--replay",
                             inputs / "plain.csv", *words(inputs)[1:], "--out", inputs / "out")  # fmt: skip
    assert (code, "one of them" in said["message"]) == (2, True)


@pytest.mark.parametrize(
    ("compared", "different_s", "said"),
    [
        (0, [], "the recording holds no answer to compare with"),
        (4, [], "4 answers compared, each the one that was given live"),
        (4, [0.5, 0.7], "2 of 4 answers are not those that were given live, the first at 0.5"),
    ],
)
def test_what_a_replay_says_is_of_the_answers_that_there_are(compared, different_s, said):
    (line,) = _replay_lines({"compared": compared, "different_s": different_s})
    assert said in line


def test_it_ends_in_time_and_writes_no_file_of_its_own(inputs, capsys):
    before = set(inputs.iterdir())
    code, said, _ = run_json(capsys, "live", *words(inputs), "--listen", "127.0.0.1:0", "--seconds", "0.05")
    assert code == 0
    assert said["registered"] == said["received"] == 0
    assert set(inputs.iterdir()) == before


def test_bad_words_exit_with_two(inputs, capsys):
    taken = socket.create_server(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    for more, message in (
        ([], "--listen or --connect must be given"),
        (["--listen", "high"], "HOST:PORT"),
        (["--connect", "18944"], "HOST:PORT"),
        (["--connect", "::1:18944"], "brackets round an address with colons"),
        (["--listen", "[]:18944"], "HOST:PORT"),
        (["--listen", port], "an address of this machine"),
        (["--listen", "a..b:0"], "an address of this machine"),
        (["--listen", "0", "--record", inputs / "reference.csv"], "must not replace an input"),
        (["--listen", "0", "--offset", "nobody 0 0 1"], "an offset must be of a marker"),
    ):
        code, said, _ = run_json(capsys, "live", *words(inputs), *more)
        assert code == 2, more
        assert message in said["message"]
    taken.close()


def test_a_port_alone_is_one_of_this_machine():
    assert live._listened("18944") == ("127.0.0.1", 18944)
    assert live._listened("[::1]:18944") == ("::1", 18944)
    assert live._address("[fe80::1%lo]:18944") == ("fe80::1%lo", 18944)


def test_an_address_with_colons_stands_in_brackets(inputs, capsys, monkeypatch):
    assert live._listened("[::1]:18944") == ("::1", 18944)
    assert live._address("[fe80::2]:1") == ("fe80::2", 1)
    if not socket.has_ipv6:
        pytest.skip("no IPv6 here")
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("no IPv6 address here")
    heard = []
    thread = feeding(monkeypatch, [(1.0, PLACES * (-1, -1, 1))], heard)
    code, _, errors = run_json(capsys, "live", *[word for word in words(inputs) if word != "--quiet"], "--listen",
                               "[::1]:0", "--frames", 1, "--surface", "none")  # fmt: skip
    thread.join(20.0)
    assert code in (0, 4)
    assert heard
    assert "listening on [::1]:" in errors


def test_ctrl_c_ends_it_and_keeps_the_recording(inputs, capsys, monkeypatch):
    async def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(live_server(), "run", interrupted)
    code, _, _ = run_json(capsys, "live", *words(inputs), "--listen", "0", "--record", inputs / "live.csv")
    assert code == 0
    assert (inputs / "live.csv").read_text().startswith("time_s,marker,x_mm,y_mm,z_mm,registered,")
