"""Signals that ask a command to end: it tidies up and ends with 130."""

import os
import signal
import threading

import numpy as np
import pytest

from support.files import GOOD_MARKERS, write_experiment
from support.meshes import block
from support.processes import Command, content
from tissuereg.cli import main
from tissuereg.io.meshes import write_vtu

NAMES = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

WRITTEN = {"diagnosis.json", "experiment.extended.toml", "report.html"}


def usual_signals():
    """What a shell in the foreground gives; one in the background ignores interrupts."""
    for name in NAMES:
        signal.signal(getattr(signal, name), signal.SIG_DFL)


@pytest.mark.parametrize("name", NAMES)
def test_a_signal_while_results_are_written_removes_the_draft(name, tmp_path, monkeypatch, capsys):
    from tissuereg.report import files

    def told_to_end(*_, **__):
        os.kill(os.getpid(), getattr(signal, name))
        raise AssertionError  # the signal comes first

    before = signal.getsignal(getattr(signal, name))
    if name == "SIGINT":
        signal.signal(signal.SIGINT, signal.default_int_handler)
    else:
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    try:
        write_vtu(tmp_path / "mesh.vtu", block())
        (tmp_path / "markers.csv").write_text(GOOD_MARKERS)
        monkeypatch.setattr(files, "write_mrk_json", told_to_end)
        words = ("register", tmp_path / "mesh.vtu", tmp_path / "markers.csv", "--out", tmp_path / "out", "--quiet")
        assert main([str(word) for word in words]) == 130
    finally:
        signal.signal(getattr(signal, name), before)
    assert capsys.readouterr().err == "interrupted\n"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["markers.csv", "mesh.vtu"]


def test_signals_that_are_ignored_stay_ignored_and_other_threads_leave_them_alone(capsys):
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        assert main(["--version"]) == 0
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
        codes = []
        thread = threading.Thread(target=lambda: codes.append(main(["--version"])))
        thread.start()
        thread.join()
        assert codes == [0]
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_signal_at_any_moment_ends_a_command_and_leaves_all_of_its_output_or_none(name, tmp_path):
    words = ("diagnose", write_experiment(tmp_path / "rig"), "--quiet", "--out", "{out}")
    for number, seconds in enumerate(np.random.default_rng(7).uniform(0.3, 2.5, 3)):
        command = Command(words, tmp_path / str(number))
        # A package that is just being imported may swallow an interrupt; the run is then whole.
        code, said = command.kill_after(seconds, getattr(signal, name), preexec_fn=usual_signals)
        # While it starts Python ends by the signal itself, or by SIGINT where it was importing an extension.
        assert code in (130, 0, -getattr(signal, name), -signal.SIGINT), said
        assert command.left() <= {"tmp", "cache", "out"}
        # A signal may come when all is written, while Python ends.
        assert not command.out.exists() or set(content(command.out)) == WRITTEN
        assert code != 0 or command.out.exists()
        assert code != 130 or said.splitlines()[-1] == "interrupted"
