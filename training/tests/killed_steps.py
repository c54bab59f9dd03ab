"""Kills the writer of a model before each of its operations on files, one after another; run as a script: FOLDER.

A process is forked for each operation; it counts what Python reports to audit hooks and kills itself before the
operation of that number. After it the model is the old one or the new one, or the next run has both at hand; that run
then leaves the new model and nothing else. Prints how many operations there were.
"""

import itertools
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import onnx

from tissuereg_training.folder import put_back, remove_unfinished, write_model


def write(place: Path, epochs: int) -> None:
    scratch = place / "model.training"
    network = onnx.ModelProto(producer_name="none")
    pages = {"MODEL.md": f"{epochs} epochs".encode()}
    write_model(place / "model", scratch, network, network, {"weights": np.zeros(3)}, {"epochs": epochs}, pages)
    scratch.rmdir()


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()} if folder.exists() else {}


def killed(place: Path, step: int) -> bool:
    pid = os.fork()
    if pid == 0:
        counter = itertools.count(1)

        def hook(event: str, _: object) -> None:
            if event.startswith(("open", "os.", "shutil.")) and next(counter) == step:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        write(place, 2)
        os._exit(0)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, status
    return os.WIFSIGNALED(status)


def main(workplace: str) -> None:
    place, scratch = Path(workplace), Path(workplace) / "model.training"
    write(place, 2)
    new = content(place / "model")
    write(place, 1)
    old = content(place / "model")
    assert old != new
    for step in itertools.count(1):
        was_killed = killed(place, step)
        assert {file.name for file in place.iterdir()} <= {"model", "model.training"}, step
        put_back(place / "model", scratch)
        assert content(place / "model") in (old, new), step
        write(place, 2)
        assert content(place / "model") == new, step
        assert [file.name for file in place.iterdir()] == ["model"], step
        if not was_killed:
            print(step - 1)
            return
        shutil.rmtree(place / "model")
        write(place, 1)
        remove_unfinished(scratch)


if __name__ == "__main__":
    main(*sys.argv[1:])
