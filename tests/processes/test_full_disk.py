"""A disk that is full: an error that says what and where, old results as they were, nothing half written."""

import contextlib
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from support.files import GOOD_MARKERS, write_experiment, write_problem
from support.meshes import block
from support.processes import Command
from tissuereg.io.atomic import OutputError, atomic_file, atomic_folder
from tissuereg.io.cache import keep_entry
from tissuereg.io.fields import write_npz
from tissuereg.io.json import write_json
from tissuereg.io.meshes import write_vtu
from tissuereg.io.recordings import read_recording

RECIPE = '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 12\nchunk = 4\n[pairs]\nmembers = 4\n'

COMMANDS = {
    "register": ("register", "{}/mesh.vtu", "{}/markers.csv", "--quiet", "--out", "{{out}}"),
    "simulate a data set": ("simulate", "{}/recipe.toml", "--quiet", "--out", "{{out}}"),
    "simulate an experiment": ("simulate", "{}/rig", "--plain", "--quiet", "--out", "{{out}}"),
    "diagnose": ("diagnose", "{}/rig", "--quiet", "--out", "{{out}}"),
    "solve": ("solve", "{}/problem.npz", "--out", "{{out}}/found.npz"),
}

#: Bytes that a file may have: less than the largest that each command writes.
ROOM = 2500


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write_experiment(folder / "rig")
    write_vtu(folder / "mesh.vtu", block())
    write_problem(folder / "problem.npz")
    (folder / "markers.csv").write_text(GOOD_MARKERS)
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


def no_room(size=ROOM):
    """No file of this process may grow beyond that; what is written beyond fails as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_a_recording_without_room_keeps_the_whole_frames_before(tmp_path):
    script = (
        "import numpy as np, resource, signal\n"
        "from pathlib import Path\n"
        "from tissuereg.io.recordings.table import LiveRow, recorder\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({ROOM}, {ROOM}))\n"
        "with recorder(Path('live.csv'), ['P1', 'P2', 'P3']) as kept:\n"
        "    try:\n"
        "        for k in range(100):\n"
        "            kept.add(LiveRow(0.1 * k, np.full((3, 3), k / 7.0), 0.1 * k, registered=True))\n"
        "    except OSError as error:\n"
        "        print(k, error.errno == 27)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    count, is_too_large = done.stdout.split()
    assert is_too_large == "True"
    found = read_recording(tmp_path / "live.csv")
    assert len(found) == int(count) > 5
    assert np.isfinite(found.places).all()
    assert (tmp_path / "live.csv").stat().st_size < ROOM
    assert [one.name for one in tmp_path.iterdir()] == ["live.csv"]


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_without_room_says_so_and_leaves_what_was_there(name, inputs, tmp_path):
    command = Command(tuple(word.format(inputs) for word in COMMANDS[name]), tmp_path)
    if "data set" not in name:
        command.out.mkdir()
        (command.out / "thesis.docx").write_text("three years")
    code, said = command.run(preexec_fn=no_room)
    assert code == 2, said
    assert "File too large" in said
    assert str(command.out) in said
    assert "Traceback" not in said
    if "data set" in name:
        assert sorted(file.name for file in command.out.iterdir()) == ["recipe.sha256"]
    else:
        assert [file.name for file in command.out.iterdir()] == ["thesis.docx"]
    assert command.left() <= {"out", "tmp", "cache"}
    code, said = command.run()  # with room
    assert code in (0, 4), said


WRITERS = {
    "json": lambda path: write_json(path, {"text": "x" * 10_000}),
    "npz": lambda path: write_npz(path, {"zeros": [0.0] * 10_000}),
    "vtu": lambda path: write_vtu(path, block()),
    "text": lambda path: write_text(path),
}


def write_text(path):
    with atomic_file(path) as temporary:
        temporary.write_text("x" * 10_000)


@contextlib.contextmanager
def limited():
    """No room for this process, while the block runs: the test runner writes its own lines to a file, too."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_that_finds_no_room_leaves_the_old_one(kind, tmp_path):
    (tmp_path / f"it.{kind}").write_text("old")
    with pytest.raises(OutputError, match=rf"it\.{kind} must be writable: File too large"), limited():
        WRITERS[kind](tmp_path / f"it.{kind}")
    assert [file.name for file in tmp_path.iterdir()] == [f"it.{kind}"]
    assert (tmp_path / f"it.{kind}").read_text() == "old"


def test_a_folder_that_finds_no_room_leaves_the_old_files(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "small").write_text("old")

    def fill():
        with atomic_folder(tmp_path / "out") as temporary:
            (temporary / "small").write_text("new")
            (temporary / "wide").write_text("x" * 10_000)

    with pytest.raises(OutputError, match="out must be writable: File too large"), limited():
        fill()
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["small"]
    assert (tmp_path / "out" / "small").read_text() == "old"


def test_a_cache_that_finds_no_room_is_no_error(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    with pytest.warns(UserWarning, match="cannot be written"), limited():
        keep_entry("bank_one", bytes(10_000), 3)
    assert not list(tmp_path.rglob("*bank*"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device that is always full")
@pytest.mark.parametrize("words", ["", "--json -"])
def test_a_standard_output_without_room_is_no_bug(words, inputs, tmp_path):
    command = f"{sys.executable} -m tissuereg solve {inputs}/problem.npz --out {tmp_path}/found.npz {words} > /dev/full"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


def may_mount() -> bool:
    if not sys.platform.startswith("linux") or shutil.which("unshare") is None:
        return False
    script = "mount -t tmpfs -o size=64k none /mnt"
    return subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not may_mount(), reason="this user may not mount a small disk")
def test_a_registration_to_a_small_disk_says_that_it_is_full_and_leaves_it_empty(inputs, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    words = f"register {inputs}/mesh.vtu {inputs}/markers.csv --quiet --out {disk}/out"
    script = (
        f"mount -t tmpfs -o size=100k none {disk} || exit 99\n"
        f"{sys.executable} -m tissuereg {words}\ncode=$?\nfind {disk} -mindepth 1\nexit $code"
    )
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, env={**os.environ}, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "No space left on device" in " ".join(done.stderr.split())
    assert done.stdout.strip() == ""
