"""A tracked recording that is interrupted leaves what was registered until then, whole and readable."""

import csv
import json
import os
import signal
import sys
import time

import numpy as np
import pytest

from support.meshes import block
from support.openigtlink import NAMES, SIT
from support.processes import PATIENCE, Command
from tissuereg.cli import main
from tissuereg.io.meshes import write_vtu
from tissuereg.tracking import Tracker
from tissuereg.tracking.stored import read_track

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of another kind")

#: Frames of the recording, ten a second.
N_FRAMES = 3000


@pytest.fixture
def inputs(tmp_path):
    write_vtu(tmp_path / "body.vtu", block())
    rows = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(NAMES, SIT.tolist(), strict=True)]
    (tmp_path / "sit.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(rows))
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,15,10,20\n")
    rng = np.random.default_rng(0)
    lines = []
    for k in range(N_FRAMES):
        for name, place in zip(NAMES, SIT + rng.normal(0.0, 0.1, SIT.shape), strict=True):
            lines.append(f"{0.1 * k!r},{name},{','.join(map(repr, place.tolist()))}\n")
    (tmp_path / "recording.csv").write_text("time_s,marker,x_mm,y_mm,z_mm\n" + "".join(lines))
    return tmp_path


def words(folder, out="out", *more):
    files = [folder / "body.vtu", folder / "recording.csv", "--reference", folder / "sit.csv"]
    files += ["--targets", folder / "targets.csv", "--out", folder / out if out else "{out}", "--fields", "--report"]
    return [str(word) for word in ("track", *files, *more)]


def check_whole(out, count):
    """Check that all files of a result are whole and hold so many frames."""
    answer = json.loads((out / "track.json").read_text("utf-8"))
    assert answer["interrupted"] is True
    assert [one["time_s"] for one in answer["frames"]] == [0.1 * k for k in range(count)]
    with (out / "targets.csv").open() as file:
        assert len(list(csv.DictReader(file))) == count
    assert len(read_track(out).times) == count
    assert (out / "report.html").read_text("utf-8").rstrip().endswith("</html>")
    assert {file.name for file in out.iterdir()} == {"track.json", "targets.csv", "fields.npz", "report.html"}


@pytest.mark.parametrize("name", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.slow)])
def test_a_real_signal_leaves_a_whole_part(inputs, name):
    command = Command(words(inputs, ""), inputs / "place")
    process = command.start()
    said = []
    for line in process.stderr:
        said.append(line)
        if "frames" in line:  # the first line of progress
            process.send_signal(getattr(signal, name))
            break
    summary, errors = process.communicate(timeout=PATIENCE)
    said = "".join([*said, errors])
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "what is in hand is finished and written" in said
    assert "Interrupted: the frames after the last one are not registered." in summary
    count = len(json.loads((command.out / "track.json").read_text("utf-8"))["frames"])
    assert 0 < count < N_FRAMES
    check_whole(command.out, count)
    assert command.left() <= {"tmp", "cache", "out"}


@pytest.fixture
def signalled(monkeypatch):
    """Return a function after which frames of this number, and all after it, send a signal to this process."""
    usual = Tracker.step
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def at(number, name="SIGINT", *, again=False):
        count = [0]

        def step(self, *args, **more):
            count[0] += 1
            if count[0] == number:
                for _ in range(1 + again):
                    os.kill(os.getpid(), getattr(signal, name))
            return usual(self, *args, **more)

        monkeypatch.setattr(Tracker, "step", step)

    yield at
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_the_frame_in_hand_is_finished_and_no_other_begun(inputs, signalled, name, capsys):
    if signal.getsignal(getattr(signal, name)) == signal.SIG_IGN:
        pytest.skip("started by nohup: a hang-up is ignored")
    signalled(5, name)
    assert main(words(inputs)) == 130
    assert "once more interrupts that too" in capsys.readouterr().err
    check_whole(inputs / "out", 5)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_signal_ends_it_at_once_and_leaves_nothing(inputs, signalled, capsys):
    signalled(5, again=True)
    before = set(inputs.iterdir())
    assert main(words(inputs)) == 130
    assert capsys.readouterr().err.rstrip().endswith("interrupted")
    assert set(inputs.iterdir()) == before


def test_an_interrupt_before_the_first_answer_writes_nothing(inputs, signalled, capsys, monkeypatch):
    from tissuereg.errors import MarkerError

    def never(*_, **__):
        os.kill(os.getpid(), signal.SIGINT)
        message = "no marker was seen"
        raise MarkerError(message)

    monkeypatch.setattr(Tracker, "step", never)
    before = set(inputs.iterdir())
    assert main(words(inputs)) == 130
    assert set(inputs.iterdir()) == before


def test_a_replay_at_the_recorded_rate_does_not_wait_for_the_next_frame(inputs, signalled):
    (inputs / "recording.csv").write_text(
        "time_s,marker,x_mm,y_mm,z_mm\n"
        + "".join(f"{time_s},{name},{x},{y},{z}\n" for time_s in (0, 500, 1000)
                  for name, (x, y, z) in zip(NAMES, SIT.tolist(), strict=True))
    )  # fmt: skip
    usual = Tracker.run

    def run(self, frames, *, wait, **more):
        def interrupted(seconds):
            os.kill(os.getpid(), signal.SIGINT)
            wait(seconds)

        return usual(self, frames, wait=interrupted, **more)

    begin = time.monotonic()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Tracker, "run", run)
        assert main(words(inputs, "out", "--live")) == 130
    assert time.monotonic() - begin < 100.0
    answer = json.loads((inputs / "out" / "track.json").read_text("utf-8"))
    assert answer["frames"][0]["time_s"] == 0.0
    assert len(answer["frames"]) < 3
