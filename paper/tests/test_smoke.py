"""Every command of `paper/Makefile` once, as small as can be: on the small phantom, with one rig and few methods."""

import json
import shutil
import sys

import numpy as np
import pytest
from common import read_archive
from scripts import fallback, paper, phantom, tune_rivals, variants
from twin import __main__ as twin
from twin import pairs
from twin import variants as rig_variants

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg.registration.learned.registration import as_model
from tissuereg_paper.cli import main
from tissuereg_paper.studies import run as running
from tissuereg_paper.studies.cases import draw_cases
from tissuereg_paper.studies.rigs import read_rig

pytestmark = pytest.mark.slow

RIG = "scenario1-101"


@pytest.fixture
def mesh():
    return tr.phantom.phantom_mesh("small")


@pytest.fixture
def small(mesh, monkeypatch):
    """The body of every command is the small one, with its own model; ten pairs of shapes become two."""
    for module in (running, fallback, tune_rivals, variants, pairs, rig_variants):
        monkeypatch.setattr(module, "phantom_mesh", lambda: mesh)
    for module in (running, fallback, tune_rivals, variants):
        monkeypatch.setattr(module, "as_model", lambda _, body, threads: as_model(SMALL_MODEL, body, threads))
    monkeypatch.setattr(running, "draw_cases", lambda *given: draw_cases(*given, n_starts=2, n_targets=2))


@pytest.fixture
def rigs(tmp_path):
    """A folder with one rig."""
    folder = tmp_path / "rigs"
    folder.mkdir()
    shutil.copy(twin.DEVELOPMENT / f"{RIG}.npz", folder)
    return folder


@pytest.fixture
def run(monkeypatch):
    """Run a script with words."""

    def done(module, *words):
        monkeypatch.setattr(sys, "argv", ["script", *map(str, words)])
        return module.main()

    return done


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """Return a script whose archive and page are copies."""

    def copied(module):
        for part in ("ARCHIVE", "PAGE"):
            path = getattr(module, part)
            copy = tmp_path / "kept" / path.name
            copy.parent.mkdir(exist_ok=True)
            (shutil.copytree if path.is_dir() else shutil.copy)(path, copy)
            monkeypatch.setattr(module, part, copy)
        return module

    return copied


def test_the_command_runs_a_simulation_study(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "draw_cases", lambda *given: draw_cases(*given, n_starts=2, n_targets=2))
    assert main(["fig8", "table2", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "answer.json")]) == 0
    answer = json.loads((tmp_path / "answer.json").read_text(encoding="utf-8"))
    assert {row["study"] for row in answer["rows"]} == {"fig8", "table2"}
    assert (tmp_path / "out" / "fig8.png").exists()


@pytest.mark.usefixtures("small")
def test_the_command_runs_the_contest(rigs, tmp_path):
    methods = [word for name in ("rigid", "kf-admm", "pbd", "tissuereg") for word in ("--method", name)]
    words = ["fig10", "phantom", "--data", rigs, *methods, "--out", tmp_path / "out", "--json", tmp_path / "a.json"]
    assert main([str(word) for word in words]) == 0
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert set(answer["methods"]) == {"simulation", "rigid", "kf-admm", "pbd", "tissuereg"}
    assert all(np.isfinite(row["sensor_mean_mm"]) for row in answer["rows"])


def test_the_page_of_simulation_studies_is_made(run, tmp_path, monkeypatch):
    monkeypatch.setattr(running, "draw_cases", lambda *given: draw_cases(*given, n_starts=2, n_targets=2))
    monkeypatch.setattr(paper, "PAGE", tmp_path / "paper.md")
    archives = {name: tmp_path / f"paper-{name}" for name in ("shipped", "graph")}
    monkeypatch.setattr(paper, "ARCHIVES", archives)
    assert run(paper) == 0
    kinds = [read_archive(folder)["studies"]["fig6"]["model"]["kind"] for folder in archives.values()]
    assert kinds == ["closure", "graph-closure"]
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert all(f"## {paper.TITLES[name]}" in text for name in archives)


@pytest.mark.usefixtures("small")
def test_the_page_of_the_contest_is_made(run, kept, rigs, tmp_path, monkeypatch):
    chosen = {name: running.METHODS[name] for name in ("simulation", "rigid", "tissuereg, network")}
    monkeypatch.setattr(running, "METHODS", chosen)
    monkeypatch.setattr(running, "PHANTOM_STUDIES", {"fig10": 1, "phantom": None})
    monkeypatch.setattr(phantom, "PHANTOM_STUDIES", {"fig10": 1, "phantom": None})
    run(kept(phantom), "--data", rigs, "--keep", tmp_path / "runs")
    studies = phantom.read()["studies"]
    assert set(studies["phantom"]["methods"]) == {"simulation", "rigid", "tissuereg"}
    assert set(studies["fig10"]["curves"]["sensor_mm"]) == set(chosen)
    run(phantom, "--data", rigs, "--keep", tmp_path / "runs", "--add", "rigid")
    assert set(phantom.read()["studies"]["phantom"]["methods"]) == {"simulation", "rigid", "tissuereg"}


@pytest.mark.usefixtures("small")
def test_the_rivals_are_tuned(run, kept, rigs, tmp_path):
    run(kept(tune_rivals), "--data", rigs, "--keep", tmp_path / "runs", "--add", "spline")
    answer = read_archive(tune_rivals.ARCHIVE)
    (sweep,) = [one for one in answer["sweeps"] if one["method"] == "thin-plate spline"]
    assert sweep["rigs"] == [RIG]
    assert len(answer["methods"]) == 20


@pytest.mark.usefixtures("small")
def test_what_is_left_of_answers_that_are_not_trusted_is_counted(run, kept, rigs, monkeypatch):
    monkeypatch.setattr(fallback, "EVERY", 13)
    monkeypatch.setattr(fallback, "NAMES", ("plain",))
    run(kept(fallback), "--data", rigs)
    assert {row["method"] for row in read_archive(fallback.ARCHIVE)["rows"]} == {"network", "contacts"}
    assert "1 development rigs" in fallback.PAGE.read_text(encoding="utf-8")


@pytest.mark.usefixtures("small")
def test_variants_are_solved_and_compared(run, kept, tmp_path, rigs, monkeypatch):
    monkeypatch.setattr(rig_variants, "N_VARIANTS", 3)
    monkeypatch.setattr(rig_variants, "SHARES", np.array([0.25, 0.5, 1.0]))
    monkeypatch.setattr(rig_variants, "DEVELOPMENT_SEEDS", {1: [101]})
    run(rig_variants, tmp_path / "variants", "--development", "--scenario", "1")
    run(rig_variants, tmp_path / "halved", "--development", "--scenario", "1", "--halved")
    with np.load(tmp_path / "variants" / f"{RIG}.npz") as made, np.load(tmp_path / "halved" / f"{RIG}.npz") as other:
        assert np.isfinite(made["push_mN"]).sum() > 4
        assert (made["young_kpa"] == 2.0 * other["young_kpa"]).all()
        # The same strokes push a softer body less hard.
        assert np.nanmean(other["push_mN"][:, 0]) < np.nanmean(made["push_mN"][:, 0])
    monkeypatch.setattr(variants, "SHARES", (0.25,))
    monkeypatch.setattr(variants, "FEWER", (2,))
    run(kept(variants), "--data", rigs, "--variants", tmp_path / "variants", "--halved", tmp_path / "halved")
    rows = read_archive(variants.ARCHIVE)["rows"]
    assert len(rows) == 7
    assert all(set(row["rigs"]) == {RIG} for row in rows)


@pytest.mark.usefixtures("small")
def test_pairs_of_rigs_are_made(run, tmp_path, monkeypatch):
    monkeypatch.setattr(pairs, "PAIR_SEEDS", [1000])
    run(pairs, tmp_path / "pairs", "--scenario", "1")
    with np.load(tmp_path / "pairs" / "pairs_1-1000.npz") as made:
        assert made["truth_mm"].shape == made["simulation_mm"].shape
        assert len(made["truth_mm"]) > 0


def test_a_rig_of_the_twin_is_made(run, tmp_path):
    run(twin, "--only", "scenario1-00", "--corners", "250", "--out", tmp_path / "rigs")
    assert read_rig(tmp_path / "rigs" / "scenario1-00.npz").shares[-1] == 1.0
