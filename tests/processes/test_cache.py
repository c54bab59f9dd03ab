"""The cache between processes: two at once, damaged, exchanged, where none can be written."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from support.files import write_experiment
from support.processes import PATIENCE, Command, content
from tissuereg.io import cache
from tissuereg.io.cache import keep_entry, read_entry

SPOILS = {
    "truncated": lambda whole: whole[: len(whole) // 2],
    "emptied": lambda whole: b"",
    "zeroed": lambda whole: bytes(len(whole)),
    "one bit": lambda whole: whole[:-100] + bytes([whole[-100] ^ 4]) + whole[-99:],
    "longer": lambda whole: whole + b"more",
    "a head alone": lambda whole: whole[:18],
}

#: What one diagnosis keeps: an entry of each kind.
KINDS = ["bank", "fine", "outside", "shape"]


def kinds_in(folder) -> list[str]:
    """The kinds of the entries in a cache, one for each, with every other file by its whole name."""
    return sorted(file.name.split("_")[0] if file.suffix == ".cached" else file.name for file in folder.iterdir())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize("spoil", SPOILS)
def test_a_damaged_entry_counts_as_absent_and_is_replaced(spoil, folder):
    keep_entry("bank_one", bytes(range(256)) * 8, 3)
    file = folder / "bank_one.cached"
    whole = file.read_bytes()
    file.write_bytes(SPOILS[spoil](whole))
    assert read_entry("bank_one") is None
    keep_entry("bank_one", bytes(range(256)) * 8, 3)
    assert file.read_bytes() == whole


def test_an_entry_with_the_content_of_another_counts_as_absent(folder):
    for name in ("bank_one", "bank_two"):
        keep_entry(name, name.encode(), 3)
    shutil.copy(folder / "bank_one.cached", folder / "bank_two.cached")
    assert (read_entry("bank_one"), read_entry("bank_two")) == (b"bank_one", None)


def test_the_oldest_entries_of_a_kind_go(folder):
    for number in range(5):
        keep_entry(f"bank_{number}", b"bank", 3)
        os.utime(folder / f"bank_{number}.cached", (number, number))
    keep_entry("fine_0", b"fine", 3)
    keep_entry("bank_9", b"bank", 3)
    assert sorted(file.stem for file in folder.iterdir()) == ["bank_3", "bank_4", "bank_9", "fine_0"]


def test_a_user_without_home_and_cache_is_warned(no_home, monkeypatch):
    monkeypatch.setattr(cache, "_WARNED", set())
    assert read_entry("bank_one") is None
    with pytest.warns(UserWarning, match="nothing is kept for the next run, the user has no home"):
        keep_entry("bank_one", b"", 3)


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """A folder with an experiment, how to diagnose it, and what a diagnosis with an empty cache says."""
    folder = tmp_path_factory.mktemp("diagnosed")
    words = ("diagnose", write_experiment(folder / "rig"), "--quiet", "--out", "{out}")
    command = Command(words, folder / "first")
    code, said = command.run()
    assert code == 0, said
    assert kinds_in(command.cache) == KINDS
    return folder, words, content(command.out)


@pytest.mark.slow
def test_two_cold_processes_at_once_on_one_cache_are_both_right(diagnosed, tmp_path):
    place, words, whole = diagnosed
    shared = {"TISSUEREG_CACHE": str(tmp_path / "shared")}
    commands = [Command(words, place / name, shared) for name in ("one", "two")]
    processes = [command.start() for command in commands]
    for command, process in zip(commands, processes, strict=True):
        _, said = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, said
        assert content(command.out) == whole
    third = Command(words, place / "three", shared)
    assert third.run()[0] == 0
    assert content(third.out) == whole
    assert kinds_in(tmp_path / "shared") == KINDS


@pytest.mark.slow
def test_a_cache_that_is_damaged_all_over_changes_no_answer(diagnosed):
    place, words, whole = diagnosed
    command = Command(words, place / "damaged")
    shutil.copytree(place / "first" / "cache", command.cache)
    files = sorted(command.cache.iterdir())
    kept = {file.name: file.read_bytes() for file in files}
    for file, other in zip(files, files[1:] + files[:1], strict=True):
        file.write_bytes(kept[other.name])
    code, said = command.run()
    assert (code, content(command.out)) == (0, whole), said
    for file in files:
        assert len(file.read_bytes()) == len(kept[file.name])
        assert file.read_bytes()[:50] == kept[file.name][:50]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["a file", "below a file"])
def test_where_nothing_can_be_kept_the_answer_is_the_same_and_one_line_says_so(kind, diagnosed, tmp_path):
    place, words, whole = diagnosed
    (tmp_path / "file").write_text("no folder")
    where = tmp_path / "file" if kind == "a file" else tmp_path / "file" / "cache"
    command = Command(words, place / f"cache in {kind}", {"TISSUEREG_CACHE": str(where)})
    code, said = command.run()
    found = content(command.out)
    assert (code, answered(found)) == (0, answered(whole)), said
    warned = [one for one in found["diagnosis.json"]["provenance"]["warnings"] if "nothing is kept" in one]
    assert len(warned) == 1
    assert said.count("nothing is kept for the next run") == 1
    assert f"{where} cannot be written" in said
    assert (tmp_path / "file").read_text() == "no folder"


def answered(found: dict) -> dict:
    """Return the content of a diagnosis without what was warned of, which its provenance lists and its page shows."""
    answer = {**found["diagnosis.json"], "provenance": {**found["diagnosis.json"]["provenance"], "warnings": []}}
    return {**found, "diagnosis.json": answer, "report.html": None}


def may_mount() -> bool:
    """Whether a process may have mounts of its own."""
    if not sys.platform.startswith("linux") or shutil.which("unshare") is None:
        return False
    return subprocess.run(["unshare", "-rm", "true"], capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not may_mount(), reason="this user may not mount, so that no home can be made read-only")
def test_with_a_read_only_home_commands_answer_and_one_line_says_that_nothing_is_kept(diagnosed, tmp_path):
    place, words, whole = diagnosed
    home = tmp_path / "home"
    home.mkdir()
    command = Command(words, place / "read-only")
    told = [str(word).replace("{out}", str(command.out)) for word in words]
    script = (
        f"mount --bind {home} {home} && mount -o remount,ro,bind {home} && exec {sys.executable} -m tissuereg {{}}"
    ).format(" ".join(told))
    environment = {**os.environ, "HOME": str(home), "OMP_NUM_THREADS": "1"}
    for name in ("TISSUEREG_CACHE", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        environment.pop(name, None)
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert answered(content(command.out)) == answered(whole)
    said = " ".join(done.stderr.split())
    assert said.count("nothing is kept for the next run") == 1
    assert json.loads((command.out / "diagnosis.json").read_text())["schema"] == "tissuereg.diagnosis/1"
    assert list(home.iterdir()) == []
