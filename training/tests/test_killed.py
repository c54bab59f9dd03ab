"""Training that is killed: what it leaves, and the next run."""

import hashlib
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import RECIPE, make_workplace

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.errors import OutputError

#: Kills at random moments.
MOMENTS = 20

NETWORKS = ("encoder.onnx", "decoder.onnx", "decoder_weights.npz")
PAGES = ("MODEL.md", "training.png")


def test_a_kill_before_any_operation_leaves_the_old_model_or_the_new_one(tmp_path):
    script = Path(__file__).with_name("killed_steps.py")
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 20  # five files, two folders moved, one removed


def start(place, out):
    words = [str(place.recipe), "--data", str(place.data), "--out", str(out), "--threads", "1", "--quiet"]
    command = [sys.executable, "-m", "tissuereg_training", *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def is_whole(model):
    card = json.loads((model / "model.json").read_text())
    found = {name: hashlib.sha256((model / name).read_bytes()).hexdigest() for name in card["files"]}
    return found == card["files"] and sorted(found) == sorted((*NETWORKS, *PAGES))


def networks(model):
    return {name: (model / name).read_bytes() for name in NETWORKS}


def test_after_a_kill_at_any_moment_the_next_run_gives_the_same_model_and_nothing_is_left(tmp_path, on_the_processor):
    place = make_workplace(tmp_path / "place", recipe=RECIPE.replace("epochs = 60", "epochs = 12"))
    began = time.monotonic()
    process = start(place, tmp_path / "whole" / "model")
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    lasted = time.monotonic() - began
    whole = networks(tmp_path / "whole" / "model")
    moments = np.random.default_rng(24).uniform(0.2 * lasted, lasted, MOMENTS)

    def killed(number):
        out = tmp_path / str(number) / "model"
        if number % 2:  # an older model stands there
            out.parent.mkdir()
            out.mkdir()
            for file in (tmp_path / "whole" / "model").iterdir():
                (out / file.name).write_bytes(file.read_bytes())
        process = start(place, out)
        time.sleep(moments[number])
        process.kill()
        process.communicate(timeout=300)
        return out, process.returncode

    def again(out):
        process = start(place, out)
        _, said = process.communicate(timeout=300)
        return process.returncode, said

    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(killed, range(MOMENTS)))
        for out, code in runs:
            assert code in (0, -9)
            left = {file.name for file in out.parent.iterdir()} if out.parent.exists() else set()
            assert left <= {"model", "model.training"}
            assert not out.exists() or is_whole(out)
        assert sum(code == -9 for _, code in runs) > MOMENTS // 2
        for (out, _), (code, said) in zip(runs, pool.map(again, [out for out, _ in runs]), strict=True):
            assert code == 0, said
            assert networks(out) == whole
            assert [file.name for file in out.parent.iterdir()] == ["model"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("PytorchStreamWriter failed")])
def test_a_checkpoint_that_finds_no_room_leaves_the_one_before(error, tmp_path, monkeypatch):
    (tmp_path / "last.pt").write_text("before")

    def fails(_, path):
        Path(path).write_text("half")
        raise error

    monkeypatch.setattr("tissuereg_training.checkpoint.torch.save", fails)
    state = type("State", (), dict.fromkeys(("epoch", "best_epoch", "best_error", "best_weights", "history")))()
    part = type("Part", (), {"state_dict": lambda self: {}})()
    with pytest.raises(OutputError, match="must be writable"):
        Checkpoint(tmp_path, "fingerprint").save(part, part, state)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("last.pt", "before")]
