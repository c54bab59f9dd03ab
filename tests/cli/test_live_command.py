"""``tissuereg live``: what it registers is what ``track`` registers from its recording."""

import json
import socket
import threading

import numpy as np
import pytest

import tissuereg as tr
from support.files import run_json
from support.openigtlink import Peer, point_message
from support.small_model import SMALL_MODEL
from tissuereg.cli import live
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


def feeding(monkeypatch, sent, heard):
    """Send frames (time, places in RAS) to the server once it listens, one answer after the other."""
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
        for time_s, places in sent:
            peer.send(point_message(places, NAMES, time_s=time_s))
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


def test_ctrl_c_ends_it_and_keeps_the_recording(inputs, capsys, monkeypatch):
    async def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(live_server(), "run", interrupted)
    code, _, _ = run_json(capsys, "live", *words(inputs), "--listen", "0", "--record", inputs / "live.csv")
    assert code == 0
    assert (inputs / "live.csv").read_text().startswith("time_s,marker,x_mm,y_mm,z_mm,registered\n")
