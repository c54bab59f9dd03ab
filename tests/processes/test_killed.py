"""Commands that are killed at random moments: what they leave, and the next run."""

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from support.files import GOOD_MARKERS, write_experiment
from support.meshes import block
from support.processes import PATIENCE, Command, content
from tissuereg.io.cache import read_entry
from tissuereg.io.drafts import DRAFT_PREFIX
from tissuereg.io.meshes import write_vtu

RECIPE = '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 24\nchunk = 4\n[pairs]\nmembers = 4\n'

#: Kills of each command.
MOMENTS = int(os.environ.get("TISSUEREG_KILLS", "20"))

COMMANDS = {
    "register": ("register", "{}/mesh.vtu", "{}/markers.csv", "--quiet", "--out", "{{out}}"),
    "simulate a data set": ("simulate", "{}/recipe.toml", "--quiet", "--out", "{{out}}"),
    "simulate an experiment": ("simulate", "{}/rig", "--quiet", "--out", "{{out}}"),
    "diagnose": ("diagnose", "{}/rig", "--quiet", "--out", "{{out}}"),
}

#: Results of the second half of the kills replace older ones; a data set is gone on with instead.
REPLACES = ("register", "simulate an experiment", "diagnose")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write_experiment(folder / "rig")
    write_vtu(folder / "mesh.vtu", block())
    (folder / "markers.csv").write_text(GOOD_MARKERS)
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


def check_cache(command, monkeypatch):
    if command.cache.exists():
        monkeypatch.setenv("TISSUEREG_CACHE", str(command.cache))
        for entry in command.cache.glob("*.cached"):
            assert read_entry(entry.stem) is not None, entry


def check_output(command, whole, old):
    """The output is absent, the old one, or the new one; a data set grows by whole files."""
    if not command.out.exists():
        assert not old
        return
    found = content(command.out)
    if command.words[0] == "simulate" and "recipe" in str(command.words[1]):
        assert set(found) <= set(whole)
        assert all(found[name] == whole[name] for name in found)
    else:
        assert set(found) == set(old or whole)
        assert all(found[name] in (whole[name], old.get(name)) for name in found)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_after_a_kill_the_next_run_is_right_and_nothing_is_left(name, inputs, tmp_path, monkeypatch):
    words = tuple(word.format(inputs) for word in COMMANDS[name])
    first = Command(words, tmp_path / "first")
    began = time.monotonic()
    code, said = first.run()
    lasted = time.monotonic() - began
    assert code in (0, 4), said
    whole = content(first.out)
    assert first.left() == {"out", "tmp", *(["cache"] if name == "diagnose" else [])}
    # No command is done with starting before a tenth of its time, none writes before.
    moments = np.random.default_rng(24).uniform(0.1 * lasted, lasted, MOMENTS)

    def killed(number):
        command = Command(words, tmp_path / str(number))
        old = {}
        if name in REPLACES and number % 2:
            command.out.mkdir()
            for file in whole:
                (command.out / file).write_text(json.dumps("old") if file.endswith(".json") else "old</html>")
            old = dict.fromkeys(whole)
            for file in [file for file in whole if file.endswith(".png")]:
                (command.out / file).write_bytes(b"old IEND0000")
            old = content(command.out)
        ended, _ = command.kill_after(moments[number])
        left = command.left()
        return command, old, ended, left

    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(killed, range(MOMENTS)))
        for command, old, ended, left in runs:
            assert ended in (-9, code)
            assert left <= {"out", "tmp", "cache", DRAFT_PREFIX}
            check_output(command, whole, old)
            check_cache(command, monkeypatch)
        assert sum(ended == -9 for _, _, ended, _ in runs) > MOMENTS // 2
        again = list(pool.map(lambda run: run[0].run(), runs))
    for (command, *_), (ended, said) in zip(runs, again, strict=True):
        assert ended == code, said
        assert content(command.out) == whole
        assert command.left() == first.left()
        assert not list(command.place.rglob(f"{DRAFT_PREFIX}*"))
        check_cache(command, monkeypatch)


def test_a_data_set_killed_between_chunks_keeps_them_and_ends_in_the_same_bits(inputs, tmp_path):
    words = ("simulate", inputs / "recipe.toml", "--quiet", "--out", "{out}")
    whole = Command(words, tmp_path / "whole")
    assert whole.run()[0] == 0
    command = Command(words, tmp_path / "killed")
    process = command.start()
    give_up = time.monotonic() + PATIENCE
    while not (command.out / "chunk_0001.h5").exists() and time.monotonic() < give_up:
        time.sleep(0.001)
    process.kill()
    process.communicate()
    assert process.returncode == -9
    kept = {file: file.stat().st_mtime_ns for file in command.out.glob("chunk_*.h5")}
    assert 2 <= len(kept) < 6
    assert not (command.out / "dataset.json").exists()
    assert command.run()[0] == 0
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    found = {file.name: file.read_bytes() for file in command.out.iterdir()}
    assert found == {file.name: file.read_bytes() for file in whole.out.iterdir()}
