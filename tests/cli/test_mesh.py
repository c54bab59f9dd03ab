"""``tissuereg mesh``: a surface becomes a body that the other commands take, or one paragraph says why not."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json
from support.surfaces import box, inverted, sphere, volume, without, write_stl
from tissuereg.meshing import fill

needs_mesher = pytest.mark.skipif(
    importlib.util.find_spec("pytetwild") is None, reason="the extra `mesh` is not installed"
)
RULES = ["--fixed", "plane 0 0 1 0 0.3", "--set", "tip", "ball 10 10 40 8"]


@pytest.fixture
def surface(tmp_path):
    """A box of 20 x 20 x 40 mm with a hole and inward normals, in cm, in a folder of its own."""
    (tmp_path / "in").mkdir()
    return write_stl(tmp_path / "in" / "bar.stl", without(inverted(box()), 2), scale=0.1)


def left_in(folder):
    return sorted(file.name for file in folder.iterdir() if file.is_file())


@needs_mesher
def test_mesh_writes_a_body_and_tells_what_it_did(surface, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path / "in")
    out = tmp_path / "made" / "bar.vtu"
    code, said, err = run_json(
        capsys, "mesh", surface, "--size", 8, "--unit", "cm", "--out", out, *RULES, "--threads", 1
    )
    assert (code, err) == (0, "")
    assert said["schema"] == "tissuereg.mesh/1"
    assert set(said) >= {
        "seconds",
        "threads",
        "machine",
        "versions",
        "nodes",
        "tets",
        "min_quality",
        "repaired",
        "seed",
    }
    assert [sentence.split()[-1] for sentence in said["repaired"]] == ["surface", "outwards"]
    seconds = said["seconds"]
    assert set(seconds) == {"read", "repair", "fill", "measure", "write", "total"}
    assert sum(seconds.values()) - seconds["total"] == pytest.approx(seconds["total"], rel=0.1)
    mesh = tr.read_mesh(out)
    assert (mesh.n_nodes, mesh.n_tets) == (said["nodes"], said["tets"])
    assert said["node_sets"] == {name: len(nodes) for name, nodes in mesh.node_sets.items()}
    assert np.abs(mesh.nodes[mesh.fixed_nodes][:, 2]).max() <= 0.3
    assert mesh.volumes.sum() == pytest.approx(said["volume_mm3"], rel=1e-12)
    # Faces keep to the surface within the deviation.
    assert said["volume_mm3"] == pytest.approx(16000.0, abs=said["deviation_mm"] * 4000.0)
    # The mesher leaves a file where it runs; that is not here.
    assert left_in(tmp_path / "in") == ["bar.stl"]
    assert left_in(tmp_path / "made") == ["bar.vtu"]


@needs_mesher
def test_without_json_mesh_prints_a_summary(tmp_path, capsys):
    file = write_stl(tmp_path / "ball.stl", sphere(subdivisions=1))
    code, out, err = run(capsys, "mesh", file, "--size", 15, "--out", tmp_path / "ball.vtu", "--threads", 1)
    assert (code, err) == (0, "")
    for words in ("shape quality at least 0.", "% against the surface", "node sets: none", f"written: {tmp_path}"):
        assert words in out
    assert tr.read_mesh(tmp_path / "ball.vtu").volumes.sum() == pytest.approx(volume(sphere(subdivisions=1)), rel=0.02)


@needs_mesher
def test_the_frame_that_a_surface_states_is_kept_with_the_body(tmp_path, capsys):
    file = write_stl(tmp_path / "ball.stl", sphere(subdivisions=1), head=b"3D Slicer output. SPACE=RAS")
    words = ["mesh", file, "--size", 15, "--threads", 1, "--set", "tip", "ball 0 0 20 8", "--out", tmp_path / "b.npz"]
    code, said, err = run_json(capsys, *words)
    assert (code, said["frame"], err) == (0, "RAS", "")
    mesh = tr.read_mesh(tmp_path / "b.npz")
    assert (mesh.frame, set(mesh.node_sets)) == ("RAS", {"tip"})
    code, said, _ = run_json(capsys, *words, "--frame", "LPS")
    assert (code, said["error"]) == (2, "FormatError")
    assert "ball.stl is in RAS, --frame LPS" in said["message"]


@needs_mesher
def test_points_in_lps_meet_a_surface_in_ras(shared_data, tmp_path, capsys):
    given = shared_data / "cases" / "frame-header"
    body = tmp_path / "gel.npz"
    words = ["mesh", given / "gel_ras.stl", "--size", 9, "--fixed", "plane 0 0 1 -48 18", "--out", body, "--threads", 1]
    assert run(capsys, *words)[0] == 0
    files = [body, given / "was.fcsv", "--measured", given / "now.fcsv", "--targets", given / "lesion_in_mesh.csv"]
    code, said, _ = run_json(capsys, "register", *files, "--quiet", "--out", tmp_path / "out")
    assert code == 0
    lesion = said["targets"]["lesion"]
    off = np.array(lesion["mean_mm"]) - (-24.05, -6.65, 12.65)
    assert np.linalg.norm(off) < lesion["region90_radii_mm"][-1]


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["--size", 8], "UnitError", "extent 4: looks like centimetres; say --unit cm"),
        (["--size", 30, "--unit", "cm"], "MeshError", "at most half of the largest extent, 20 mm"),
        (["--size", 8, "--unit", "cm", "--fixed", "plane 0 0 1"], "FormatError", "plane nx ny nz d [tol]"),
        (["--size", 8, "--unit", "cm", "--set", "lid", "ball 1"], "FormatError", "`lid` must be 'ball x y z r'"),
    ],
)
def test_bad_input_exits_with_two_and_leaves_no_file(surface, tmp_path, capsys, words, error, message):
    code, said, err = run_json(capsys, "mesh", surface, *words, "--out", tmp_path / "bar.vtu")
    assert (code, said["schema"], said["error"]) == (2, "tissuereg.error/1", error)
    assert message in said["message"]
    assert "Traceback" not in err
    assert left_in(tmp_path) == []


def test_a_missing_mesher_exits_with_two_and_names_the_extra(surface, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    code, said, _ = run_json(capsys, "mesh", surface, "--size", 8, "--unit", "cm", "--out", tmp_path / "bar.vtu")
    assert (code, said["error"]) == (2, "MissingPackageError")
    assert "pip install 'tissuereg[mesh]'" in said["message"]
    assert left_in(tmp_path) == []


def test_a_mesher_that_gives_up_exits_with_three_and_leaves_the_old_file(surface, tmp_path, capsys, monkeypatch):
    (tmp_path / "bar.vtu").write_text("of yesterday")
    monkeypatch.setattr("tissuereg.meshing.body.check_mesher", lambda: None)
    monkeypatch.setattr(
        fill.subprocess, "run", lambda words, **_: subprocess.CompletedProcess(words, -6, "", "stopped")
    )
    words = ["mesh", surface, "--size", 8, "--unit", "cm", "--out", tmp_path / "bar.vtu", "--json", tmp_path / "e.json"]
    code, _, err = run(capsys, *words)
    assert code == 3
    assert "was ended by signal 6: stopped" in " ".join(err.split())
    assert json.loads((tmp_path / "e.json").read_text())["error"] == "MeshingError"
    assert (tmp_path / "bar.vtu").read_text() == "of yesterday"


def test_an_output_never_replaces_the_surface(tmp_path, capsys):
    (tmp_path / "skin.vtu").write_text("")
    code, said, _ = run_json(capsys, "mesh", tmp_path / "skin.vtu", "--size", 8, "--out", tmp_path / "skin.vtu")
    assert (code, said["error"]) == (2, "UsageError")
    assert "must not replace an input" in said["message"]
