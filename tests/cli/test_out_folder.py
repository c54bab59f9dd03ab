"""A folder for results may hold other files: they are left alone, and those of the same command are replaced."""

import importlib

import numpy as np
import pytest

from support.files import GOOD_MARKERS, run_json, write_experiment
from support.meshes import block
from tissuereg.cli import main
from tissuereg.errors import TissueRegError
from tissuereg.io.meshes import write_vtu

RECIPE = '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 2\nchunk = 2\n'


@pytest.fixture
def inputs(tmp_path):
    write_vtu(tmp_path / "mesh.vtu", block())
    (tmp_path / "markers.csv").write_text(GOOD_MARKERS)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    write_experiment(tmp_path / "rig")
    return tmp_path


def reached(*given, **named):
    message = "the work has begun"
    raise TissueRegError(message, where="work")


WORKS = {
    "registration.register.register": ("register", "{}/mesh.vtu", "{}/markers.csv"),
    "diagnosis.diagnose": ("diagnose", "{}/rig"),
    "simulation.believed.simulate_experiment": ("simulate", "{}/rig", "--plain"),
    "phantom.demo.run_demo": ("demo",),
}


@pytest.mark.parametrize(("work", "command"), WORKS.items(), ids=[command[0] for command in WORKS.values()])
def test_a_folder_of_other_files_is_taken(work, command, inputs, capsys, monkeypatch):
    module, _, name = work.rpartition(".")
    # By its full name: `tissuereg.diagnose` is the function.
    monkeypatch.setattr(importlib.import_module(f"tissuereg.{module}"), name, reached)
    (inputs / "out").mkdir()
    (inputs / "out" / "thesis.docx").write_text("three years")
    words = [word.format(inputs) for word in command]
    _, said, _ = run_json(capsys, *words, "--out", inputs / "out", "--quiet")
    assert said["message"] == "the work has begun"
    assert [file.name for file in (inputs / "out").iterdir()] == ["thesis.docx"]


def test_foreign_files_are_left_alone_and_those_of_the_same_command_are_replaced(inputs, capsys):
    out = inputs / "out"
    out.mkdir()
    (out / "thesis.docx").write_text("three years")
    (out / "case_lean.npz").write_text("of an older run")
    words = ["simulate", inputs / "rig", "--plain", "--out", out, "--quiet", "--json", out / "said.json"]
    for _ in range(2):
        assert main([str(word) for word in words]) == 0
    capsys.readouterr()
    assert (out / "thesis.docx").read_text() == "three years"
    assert (out / "said.json").exists()
    with np.load(out / "case_lean.npz") as fields:
        assert fields["displacement_mm"].shape[1:] == (120, 3)
    made = (out / "experiment.toml").read_bytes()
    main([str(word) for word in ("register", inputs / "mesh.vtu", inputs / "markers.csv", "--out", out, "--quiet")])
    assert (out / "registered.vtu").exists()
    assert (out / "thesis.docx").read_text() == "three years"
    assert (out / "experiment.toml").read_bytes() == made


def test_results_may_lie_beside_their_inputs(inputs, capsys):
    main([str(w) for w in ("register", inputs / "mesh.vtu", inputs / "markers.csv", "--out", inputs, "--quiet")])
    capsys.readouterr()
    assert (inputs / "registered.vtu").exists()
    assert (inputs / "markers.csv").read_text() == GOOD_MARKERS
    assert (inputs / "recipe.toml").read_text() == RECIPE


def test_a_data_set_does_not_begin_among_other_files(inputs, capsys, monkeypatch):
    monkeypatch.setattr(importlib.import_module("tissuereg.simulation.dataset"), "make_one_chunk", reached)
    out = inputs / "out"
    out.mkdir()
    (out / "thesis.docx").write_text("three years")
    code, said, _ = run_json(capsys, "simulate", inputs / "recipe.toml", "--out", out, "--quiet")
    assert (code, said["where"]) == (2, str(out))
    assert "it holds other files" in said["message"]
    assert [file.name for file in out.iterdir()] == ["thesis.docx"]


def test_a_data_set_with_a_spoilt_chunk_names_it_and_goes_on_without_it(inputs, capsys):
    words = ("simulate", inputs / "recipe.toml", "--out", inputs / "out", "--quiet")
    assert run_json(capsys, *words)[0] == 0
    chunk = inputs / "out" / "chunk_0000.h5"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[:500])
    code, said, _ = run_json(capsys, *words)
    assert (code, said["error"], said["where"]) == (2, "FormatError", str(chunk))
    chunk.unlink()
    assert run_json(capsys, *words)[0] == 0
    assert chunk.read_bytes() == whole


def test_a_data_set_that_was_killed_before_its_mesh_was_written_is_gone_on_with(inputs, capsys):
    words = ("simulate", inputs / "recipe.toml", "--out", inputs / "out", "--quiet")
    assert run_json(capsys, *words)[0] == 0
    whole = {file.name: file.read_bytes() for file in (inputs / "out").iterdir()}
    for name in set(whole) - {"recipe.sha256"}:
        (inputs / "out" / name).unlink()
    assert run_json(capsys, *words)[0] == 0
    assert {file.name: file.read_bytes() for file in (inputs / "out").iterdir()} == whole
