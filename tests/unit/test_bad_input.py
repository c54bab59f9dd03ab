"""Bad input, through Python and through the command: what must hold, what was found, where; nothing is written."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tissuereg as tr
from support.files import GOOD_MARKERS, MARKERS_HEADER, problem_arrays, run_json, write_experiment, write_problem
from support.meshes import block
from tissuereg.errors import (
    ConvergenceError,
    FormatError,
    MarkerError,
    MaterialError,
    MeshError,
    MissingPackageError,
    ModelError,
    ShapeError,
    SupportError,
    TissueRegError,
    UnitError,
)
from tissuereg.io.meshes import write_vtu
from tissuereg.io.problems import read_problem, read_simulation
from tissuereg.simulation.recipe import read_recipe


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Keep priors out of the user's cache."""
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


def refuses(capsys, call: Callable[[], Any], words: list, error: type[TissueRegError], pattern: str, folder: Path):
    """Check one bad input both ways; `folder` must hold the same files afterwards."""
    before = sorted(folder.rglob("*"))
    with pytest.raises(error, match=pattern) as caught:
        call()
    assert type(caught.value) is error
    code, output, err = run_json(capsys, *words, "--quiet")
    assert (code, output["schema"], output["error"]) == (error.exit_code, "tissuereg.error/1", error.__name__)
    assert output["where"], "the place must be told"
    with pytest.raises(error, match=pattern):
        raise error(output["message"])
    assert err.startswith("error: ")
    assert " ".join(err.split()) == " ".join(f"error: {output['message']}".split())
    assert "Traceback" not in err
    assert sorted(folder.rglob("*")) == before


def inverted() -> np.ndarray:
    tets = block().tets.copy()
    tets[17] = tets[17, [1, 0, 2, 3]]
    return tets


def flat() -> np.ndarray:
    nodes = block().nodes.copy()
    corners = block().tets[5]
    nodes[corners[3]] = nodes[corners[:3]].mean(axis=0)
    return nodes


def two_parts() -> dict[str, np.ndarray]:
    """A held block, and another next to it that nothing holds."""
    one = block()
    return {
        "nodes_mm": np.vstack([one.nodes, one.nodes + np.array([60.0, 0.0, 0.0])]),
        "tets": np.vstack([one.tets, one.tets + one.n_nodes]),
        "fixed_nodes": one.fixed_nodes,
        "forces_mN": np.zeros((2 * one.n_nodes, 3)),
    }


def out_of_range() -> np.ndarray:
    tets = block().tets.copy()
    tets[3, 2] = 500
    return tets


def one_nan() -> np.ndarray:
    nodes = block().nodes.copy()
    nodes[7, 1] = np.nan
    return nodes


#: Change of a good problem; the error; a part of its message.
PROBLEMS: dict[str, tuple[dict[str, Any], type[TissueRegError], str]] = {
    "a tet is inverted": ({"tets": inverted()}, MeshError, r"tetrahedron 17 is inverted"),
    "a tet is flat": ({"nodes_mm": flat()}, MeshError, r"tetrahedron \d+ is (degenerate|inverted)"),
    "an index is out of range": ({"tets": out_of_range()}, MeshError, r"tetrahedron 3 names node 500.* 120 nodes"),
    "an index is negative": ({"tets": block().tets - 1}, MeshError, r"-1"),
    "a node is in no tet": ({"nodes_mm": np.vstack([block().nodes, [[1.0, 1.0, 1.0]]])}, MeshError, r"node 120"),
    "a coordinate is NaN": (
        {"nodes_mm": one_nan()},
        MeshError,
        r"problem\.npz: node coordinates must be finite.*node 7 is",
    ),
    "a coordinate is infinite": (
        {"nodes_mm": block().nodes + np.array([0.0, 0.0, np.inf])},
        MeshError,
        r"problem\.npz: node coordinates must be finite.*node 0 is",
    ),
    "lengths are in metres": (
        {"nodes_mm": block().nodes / 1000},
        UnitError,
        r"must be in mm: a body of extent 0.04 mm",
    ),
    "lengths are in micrometres": ({"nodes_mm": block().nodes * 1000}, UnitError, r"must be in mm: .*4e\+04 mm"),
    "nothing is held": ({"fixed_nodes": np.array([], np.int64)}, MeshError, r"'fixed' must hold at least one node"),
    "one node is held": ({"fixed_nodes": np.array([0])}, SupportError, r"rotat"),
    "an edge is held": ({"fixed_nodes": np.array([0, 6])}, SupportError, r"rotat"),
    "a part is loose": (two_parts(), SupportError, r"part"),
    "a held node is out of range": ({"fixed_nodes": np.array([0, 999])}, MeshError, r"nodes 0 to 119, got 999"),
    "forces are missing": ({"forces_mN": None}, FormatError, r"'forces_mN'; it holds: nodes_mm"),
    "forces have another shape": ({"forces_mN": np.zeros((3, 3))}, FormatError, r"shape \(120, 3\), got \(3, 3\)"),
    "a force is infinite": (
        {"forces_mN": np.full((120, 3), np.inf)},
        FormatError,
        r"'forces_mN' in .* finite, got inf",
    ),
    "tets hold floats": ({"tets": block().tets * 1.0}, FormatError, r"`tets` must hold integers"),
    "moduli are pickled": ({"young_kPa": np.array([{}, None])}, FormatError, r"'young_kPa' .* pickled objects"),
    "nu is one half": ({"poisson": 0.5}, MaterialError, r"`poisson` must be in \(-1, 0.5\), got 0.5"),
    "nu is minus one": ({"poisson": -1.0}, MaterialError, r"`poisson` must be in \(-1, 0.5\), got -1"),
    "nu of one tet is off": ({"poisson": np.r_[np.full(359, 0.3), 0.7]}, MaterialError, r"got 0.7 at tet 359"),
    "E is negative": ({"young_kPa": -3.0}, MaterialError, r"`young` must be positive, in kPa, got -3"),
    "E has another count": (
        {"young_kPa": np.ones(9)},
        FormatError,
        r"`young_kPa` must have shape \(360,\), got \(9,\)",
    ),
}


@pytest.mark.parametrize(("changes", "error", "pattern"), PROBLEMS.values(), ids=PROBLEMS)
def test_a_bad_problem_is_refused(tmp_path, capsys, changes, error, pattern):
    path = write_problem(tmp_path / "problem.npz", **changes)

    def call():
        problem = read_problem(path)
        tr.simulate(problem.mesh, problem.load, problem.material)

    refuses(capsys, call, ["solve", path, "--out", tmp_path / "u.npz"], error, pattern, tmp_path)


def test_a_load_beyond_equilibrium_reports_how_far_it_got_and_where(tmp_path, capsys):
    forces = np.zeros((120, 3))
    forces[block().nodes[:, 2] == 40.0, 2] = -1e6
    path = write_problem(tmp_path / "problem.npz", forces_mN=forces)
    problem = read_problem(path)
    with pytest.raises(ConvergenceError) as caught:
        tr.simulate(problem.mesh, problem.load, problem.material)
    assert 0.0 <= caught.value.report["load_fraction"] < 1.0
    assert caught.value.report["worst_tets"]
    code, output, err = run_json(capsys, "solve", path, "--out", tmp_path / "u.npz")
    assert (code, output["error"]) == (3, "ConvergenceError")
    assert 0.0 <= output["report"]["load_fraction"] < 1.0
    assert "Traceback" not in err
    assert not (tmp_path / "u.npz").exists()


FILES: dict[str, tuple[str, bytes, str]] = {
    "no such file": ("problem.npz", b"", "no such file"),
    "no archive": ("problem.npz", b"these are words", r"must be a numpy archive"),
    "an empty file": ("problem.npz", b" ", r"must be a numpy archive"),
    "a pickle": ("problem.npz", b"\x80\x04}q\x00.", r"pickled objects are never loaded"),
}


@pytest.mark.parametrize(("name", "content", "pattern"), FILES.values(), ids=FILES)
def test_a_file_that_is_no_problem_is_refused(tmp_path, capsys, name, content, pattern):
    path = tmp_path / name
    if content:
        path.write_bytes(content)
    words = ["solve", path, "--out", tmp_path / "u.npz"]
    refuses(capsys, lambda: read_problem(path), words, FormatError, pattern, tmp_path)


@dataclass
class Registration:
    """A registration with one thing wrong; files are written by name, options go to both ways."""

    error: type[TissueRegError]
    pattern: str
    markers: str = GOOD_MARKERS
    mesh: str = "mesh.vtu"
    files: dict[str, str | bytes] = field(default_factory=dict)
    arrays: dict[str, dict[str, Any]] = field(default_factory=dict)
    options: dict[str, str] = field(default_factory=dict)


HIGH = MARKERS_HEADER + "P1,30,10,400,31,10,400\n"

REGISTRATIONS = {
    "all markers are missing": Registration(
        MarkerError, r"at least one marker must have been seen; all 1 are missing", MARKERS_HEADER + "P1,30,10,40,,,\n"
    ),
    "a marker is far from the body": Registration(MarkerError, r"'P1'", HIGH),
    "a marker is infinite": Registration(FormatError, r"'moved_x_mm'.*'inf'", GOOD_MARKERS.replace("31", "inf")),
    "a marker stands twice": Registration(
        FormatError, r"'P2' is at line 3 and line 5", GOOD_MARKERS + "P2,1,2,3,4,5,6\n"
    ),
    "markers have another header": Registration(FormatError, r"must begin with the header", "name,x\nP1,3\n"),
    "no marker file": Registration(FormatError, r"no such file: .*markers\.csv", ""),
    "the mesh is text": Registration(
        FormatError, r"must be a mesh of the kind", mesh="words.vtu", files={"words.vtu": "no mesh"}
    ),
    "the mesh is of an unknown kind": Registration(
        FormatError,
        r"one of \.vtu, \.vtk, \.msh, \.xdmf, \.npz, got 'm\.docx'",
        mesh="m.docx",
        files={"m.docx": "no mesh"},
    ),
    "the mesh is a surface": Registration(FormatError, r"holds a surface only", mesh="m.stl", files={"m.stl": "solid"}),
    "nothing is held": Registration(
        MeshError,
        r"must have a node set named 'fixed'; it has: none",
        mesh="free.npz",
        arrays={"free.npz": {"nodes_mm": block().nodes, "tets": block().tets}},
    ),
    "the plane holds nothing": Registration(MeshError, r"nearest is 50 mm", options={"fixed": "plane 0 0 1 -50 1"}),
    "the plane is half said": Registration(FormatError, r"plane nx ny nz d \[tol\]", options={"fixed": "plane 0 0 1"}),
    "the node set is unknown": Registration(MeshError, r"'chest wall'; it has: fixed", options={"fixed": "chest wall"}),
    "the model is no folder": Registration(ModelError, r"model\.json", options={"model": "{folder}/gone"}),
    "the model is another mesh's": Registration(ModelError, r"mesh", options={"model": "phantom"}),
    "a target lies outside": Registration(
        MarkerError,
        r"'lesion' must lie in the undeformed body",
        files={"t.csv": "target,x_mm,y_mm,z_mm\nlesion,15,10,90\n"},
        options={"targets": "{folder}/t.csv"},
    ),
    "a target is text": Registration(
        FormatError,
        r"'z_mm'.*'deep' at .*t\.csv line 2",
        files={"t.csv": "target,x_mm,y_mm,z_mm\nlesion,15,10,deep\n"},
        options={"targets": "{folder}/t.csv"},
    ),
    "the simulation is another mesh's": Registration(
        FormatError,
        r"`displacement_mm` must have shape \(120, 3\), got \(9, 3\)",
        arrays={"u.npz": {"displacement_mm": np.zeros((9, 3))}},
        options={"simulation": "{folder}/u.npz"},
    ),
    "the simulation is not finite": Registration(
        FormatError,
        r"'displacement_mm' in .* finite, got nan",
        arrays={"u.npz": {"displacement_mm": np.full((120, 3), np.nan)}},
        options={"simulation": "{folder}/u.npz"},
    ),
    "the simulation lacks its array": Registration(
        FormatError,
        r"an array 'displacement_mm'; it holds: u",
        arrays={"u.npz": {"u": np.zeros((120, 3))}},
        options={"simulation": "{folder}/u.npz"},
    ),
}


@pytest.mark.parametrize("bad", REGISTRATIONS.values(), ids=REGISTRATIONS)
def test_a_bad_registration_is_refused(tmp_path, capsys, bad):
    write_vtu(tmp_path / "mesh.vtu", block())
    if bad.markers:
        (tmp_path / "markers.csv").write_text(bad.markers)
    for name, text in bad.files.items():
        (tmp_path / name).write_text(str(text))
    for name, arrays in bad.arrays.items():
        np.savez(tmp_path / name, **arrays)
    options = {name: value.format(folder=tmp_path) for name, value in bad.options.items()}

    def call():
        mesh = tr.read_mesh(tmp_path / bad.mesh, fixed=options.get("fixed"))
        markers = tr.read_markers(tmp_path / "markers.csv")
        simulation = read_simulation(options["simulation"], mesh.n_nodes) if "simulation" in options else None
        targets = tr.read_targets(options["targets"]) if "targets" in options else None
        assert len(mesh.fixed_nodes)
        tr.register(mesh, markers, model=options.get("model"), simulation=simulation, targets=targets)

    words = ["register", tmp_path / bad.mesh, tmp_path / "markers.csv", "--out", tmp_path / "out"]
    words += [word for name, value in options.items() for word in (f"--{name}", value)]
    refuses(capsys, call, words, bad.error, bad.pattern, tmp_path)


def test_a_frame_that_does_not_exist_is_refused(tmp_path, capsys):
    folder = write_experiment(tmp_path / "rig")
    for case, time, pattern in (("bend", 10.0, "a case 'bend'"), ("lean", 99.0, "from 10 to 11 s")):
        words = ["register", folder, "--case", case, "--time", time, "--out", tmp_path / "out"]

        def call(case=case, time=time):
            tr.read_experiment(folder).frame(case, time)

        refuses(capsys, call, words, tr.errors.ExperimentError, pattern, tmp_path)


RECIPES = {
    "no TOML": "[mesh",
    "an unknown table": 'colour = 1\n[mesh]\nfile = "phantom"\n',
    "an unknown key": '[mesh]\nfile = "phantom"\n[data]\nmember = 3\n',
    "a value of another kind": '[mesh]\nfile = "phantom"\n[data]\nmembers = "many"\n',
    "no mesh": "seed = 3\n",
    "two meshes": '[mesh]\nfile = "phantom"\nsource = "phantom"\n',
    "an unknown body": '[mesh]\nsource = "liver"\n',
    "nodes as text": '[mesh]\nsource = "phantom"\nn_nodes = "many"\n',
    "shares above one": '[mesh]\nfile = "phantom"\n[data]\nplate_share = 0.6\ngravity_share = 0.5\n',
    "a limit below the wanted motion": '[mesh]\nfile = "phantom"\n[data]\nmost_mm = 20.0\n',
}


@pytest.mark.parametrize("text", RECIPES.values(), ids=RECIPES)
def test_a_bad_recipe_is_refused(tmp_path, capsys, text):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    words = ["simulate", path, "--out", tmp_path / "data"]
    refuses(capsys, lambda: read_recipe(path), words, tr.errors.ExperimentError, r"recipe\.toml", tmp_path)


@pytest.mark.skipif(importlib.util.find_spec("tissuereg_training") is not None, reason="the training package is there")
def test_training_without_its_package_states_how_to_get_it(tmp_path, capsys):
    code, output, _ = run_json(capsys, "train", tmp_path / "r.toml", "--data", tmp_path, "--out", tmp_path / "model")
    assert (code, output["error"]) == (2, MissingPackageError.__name__)
    assert "make training" in output["message"]
    assert "pip install ./training" in output["message"]
    assert not (tmp_path / "model").exists()


ARRAYS: dict[str, tuple[Callable[[], Any], type[TissueRegError], str]] = {
    "nodes in a plane": (
        lambda: tr.Mesh(np.zeros((4, 2)), [[0, 1, 2, 3]]),
        ShapeError,
        r"`nodes` must have shape \(any, 3\)",
    ),
    "nodes as text": (lambda: tr.Mesh("mesh.vtu", [[0, 1, 2, 3]]), ShapeError, r"`nodes` must be an array of numbers"),
    "tets as floats": (lambda: tr.Mesh(block().nodes, block().tets * 1.0), ShapeError, r"`tets` must hold integers"),
    "tets of three": (lambda: tr.Mesh(block().nodes, block().tets[:, :3]), ShapeError, r"`tets` must have shape"),
    "a NaN node": (lambda: tr.Mesh(one_nan(), block().tets), MeshError, r"finite numbers in mm; node 7 is at"),
    "no tets": (lambda: tr.Mesh(block().nodes, np.empty((0, 4), int)), MeshError, r"at least one tet"),
    "an unknown set": (lambda: block().node_set("lid"), MeshError, r"'lid'; it has: fixed"),
    "a set out of range": (lambda: tr.Mesh(block().nodes, block().tets, {"a": [120]}), MeshError, r"got 120"),
    "markers that differ": (lambda: tr.Markers(np.zeros((3, 3)), np.zeros((2, 3))), ShapeError, r"`measured`"),
    "marker noise zero": (
        lambda: tr.Markers(np.zeros((1, 3)), np.zeros((1, 3)), 0.0),
        MarkerError,
        r"std must be positive",
    ),
    "an unknown law": (
        lambda: tr.Material(law="jelly"),
        MaterialError,
        r"`law` must be one of neo-hookean, bimodular, .* got 'jelly'",
    ),
    "a NaN modulus": (lambda: tr.Material(young=float("nan")), MaterialError, r"`young` must be positive"),
    "forces of another mesh": (
        lambda: tr.simulate(block(), tr.Load(forces=np.zeros((4, 3))), tr.Material()),
        ShapeError,
        r"`forces` must have shape \(120, 3\), got \(4, 3\)",
    ),
    "moduli of another mesh": (
        lambda: tr.simulate(block(), tr.Load(body_force=[0, 0, 1e-3]), tr.Material(young=np.ones(7))),
        MaterialError,
        r"one value or one per tet \(360\), got 7",
    ),
    "an infinite force": (
        lambda: tr.simulate(block(), tr.Load(forces=np.full((120, 3), np.inf)), tr.Material()),
        tr.errors.LoadError,
        r"must be finite",
    ),
    "no mesh at all": (lambda: tr.register("mesh.vtu", "markers.csv"), ShapeError, r"`mesh` must be a Mesh, a Body or"),
}


@pytest.mark.parametrize(("call", "error", "pattern"), ARRAYS.values(), ids=ARRAYS)
def test_bad_arrays_are_refused(call, error, pattern):
    with pytest.raises(error, match=pattern) as caught:
        call()
    assert type(caught.value) is error


def test_the_good_input_of_this_file_is_good(tmp_path):
    problem = read_problem(write_problem(tmp_path / "problem.npz"))
    assert np.abs(tr.simulate(problem.mesh, problem.load, problem.material).displacement).max() > 0.1
    assert sorted(problem_arrays()) == ["fixed_nodes", "forces_mN", "nodes_mm", "poisson", "tets", "young_kPa"]
