"""Files that are nearly right, with bytes flipped, ends cut, lines exchanged: read, or refused by an error of ours."""

import re
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tissuereg as tr
from support.files import EXPERIMENT, FIDUCIALS, GOOD_MARKERS, TABLES, write_experiment, write_problem
from support.meshes import block
from tissuereg.errors import TissueRegError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.mrk_json import write_mrk_json
from tissuereg.io.problems import read_problem, read_simulation
from tissuereg.io.surfaces import read_triangles
from tissuereg.simulate.recipe import read_recipe

#: The same examples at every run; a file is read within so many ms, whatever it holds.
FUZZED = settings(
    max_examples=60,
    derandomize=True,
    deadline=3000,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

#: What may stand in the place of a number or a word.
STRANGE = st.sampled_from(
    [
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "1e999",
        "99999999999999999999",
        "0x10",
        "",
        '"',
        "'",
        "[]",
        "{}",
        "a,b",
        "\0",
        "é",
    ]
)
PLACES = st.floats(0.0, 1.0, exclude_max=True)


def _flipped(content: bytes, at: float, with_: int) -> bytes:
    spot = int(at * len(content))
    return content[:spot] + bytes([content[spot] ^ with_]) + content[spot + 1 :] if content else content


def _cut(content: bytes, begin: float, length: float) -> bytes:
    first = int(begin * len(content))
    return content[:first] + content[first + int(length * (len(content) - first)) :]


def _lines_exchanged(content: bytes, one: float, other: float) -> bytes:
    lines = content.split(b"\n")
    i, j = int(one * len(lines)), int(other * len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _line_repeated(content: bytes, at: float) -> bytes:
    lines = content.split(b"\n")
    return b"\n".join([*lines[: int(at * len(lines)) + 1], *lines[int(at * len(lines)) :]])


def _word_replaced(content: bytes, at: float, word: str) -> bytes:
    words = list(re.finditer(rb"[\w.+-]+", content))
    if not words:
        return content
    found = words[int(at * len(words))]
    return content[: found.start()] + word.encode() + content[found.end() :]


#: One thing that goes wrong with a file.
CHANGES = st.one_of(
    st.tuples(st.just(_flipped), PLACES, st.integers(1, 255)),
    st.tuples(st.just(_cut), PLACES, st.one_of(st.just(1.0), st.floats(0.0, 0.1))),
    st.tuples(st.just(_lines_exchanged), PLACES, PLACES),
    st.tuples(st.just(_line_repeated), PLACES),
    st.tuples(st.just(_word_replaced), PLACES, STRANGE),
)


def spoilt(content: bytes, changes) -> bytes:
    for change, *how in changes:
        content = change(content, *how)
    return content


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """A folder with one good file of every kind."""
    folder = tmp_path_factory.mktemp("good")
    mesh = block(cells=(1, 1, 2))
    write_vtu(folder / "mesh.vtu", mesh)
    content = meshio.Mesh(
        mesh.nodes, [("tetra", mesh.tets)], point_data={"fixed": (mesh.nodes[:, 2] == 0.0).astype(float)}
    )
    content.write(folder / "ascii.vtu", binary=False)
    content.write(folder / "mesh.vtk", binary=False)
    meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]).write(folder / "mesh.msh", file_format="gmsh22", binary=False)
    np.savez(folder / "mesh.npz", nodes_mm=mesh.nodes, tets=mesh.tets, fixed_nodes=mesh.fixed_nodes)
    write_problem(folder / "problem.npz")
    np.savez(folder / "simulation.npz", displacement_mm=np.zeros((3, 3)))
    (folder / "markers.csv").write_text(GOOD_MARKERS)
    (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,1,2,3\ndeep,4,5,6\n")
    (folder / "surface.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n4,5,6\n7,8,9\n")
    (folder / "sit.fcsv").write_text(FIDUCIALS)
    write_mrk_json(folder / "targets.mrk.json", {"lesion": ((1, 2, 3), "found"), "deep": ((4, 5, 6), "")}, "RAS")
    for suffix in ("stl", "ply", "obj", "off"):
        body = trimesh.Trimesh(mesh.nodes, mesh.surface, process=False)
        body.export(folder / f"body.{suffix}", **({"encoding": "ascii"} if suffix == "ply" else {}))
    meshio.Mesh(mesh.nodes, [("triangle", mesh.surface)]).write(folder / "body.vtu", binary=False)
    (folder / "recipe.toml").write_text(
        'seed = 3\n[mesh]\nfile = "mesh.vtu"\n[material]\nyoung_kpa = [5.0, 15.0]\npoisson = 0.45\n'
        "[data]\nmembers = 12\nchunk = 6\nlargest_mm = [1.0, 9.0]\n"
    )
    write_experiment(folder / "rig")
    test = folder / "test"
    test.mkdir()
    (test / "experiment.toml").write_text('kind = "material-test"\n[material]\nyoung_kpa = 3.0\npoisson = 0.49\n')
    rows = "".join(f"a,tension,,,{1 + 0.1 * i:.1f},{0.2 * i:.1f}\n" for i in range(1, 6))
    (test / "test.csv").write_text("specimen,mode,rate_per_s,time_s,stretch_or_shear,stress_kPa\n" + rows)
    return folder


#: A reader, and the files that it is given.
READERS = [
    pytest.param(tr.read_mesh, "mesh.vtu", id="mesh.vtu"),
    pytest.param(tr.read_mesh, "ascii.vtu", id="ascii.vtu"),
    pytest.param(tr.read_mesh, "mesh.vtk", id="mesh.vtk"),
    pytest.param(tr.read_mesh, "mesh.msh", id="mesh.msh"),
    pytest.param(tr.read_mesh, "mesh.npz", id="mesh.npz"),
    pytest.param(read_problem, "problem.npz", id="problem.npz"),
    pytest.param(read_simulation, "simulation.npz", id="simulation.npz"),
    pytest.param(tr.read_markers, "markers.csv", id="markers.csv"),
    pytest.param(tr.read_targets, "targets.csv", id="targets.csv"),
    pytest.param(tr.read_surface, "surface.csv", id="surface.csv"),
    pytest.param(tr.read_targets, "sit.fcsv", id="sit.fcsv"),
    pytest.param(tr.read_targets, "targets.mrk.json", id="targets.mrk.json"),
    *(pytest.param(read_triangles, f"body.{kind}", id=f"body.{kind}") for kind in ("stl", "ply", "obj", "off", "vtu")),
    pytest.param(read_recipe, "recipe.toml", id="recipe.toml"),
]


def reads_or_refuses(read, path):
    refused = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            read(path)
        except TissueRegError as error:
            refused = error
    if refused is not None:
        assert str(refused)
        assert isinstance(refused.where, str)


@pytest.mark.parametrize(("read", "name"), READERS)
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_spoilt_file_is_read_or_refused(good, read, name, changes):
    path = good / f"spoilt-{name}"
    path.write_bytes(spoilt((good / name).read_bytes(), changes))
    reads_or_refuses(read, path)


@pytest.mark.parametrize("name", ["experiment.toml", *TABLES])
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_an_experiment_with_a_spoilt_file_is_read_or_refused(good, name, changes):
    whole = EXPERIMENT if name == "experiment.toml" else TABLES[name]
    path = good / "rig" / name
    try:
        path.write_bytes(spoilt(whole.encode(), changes))
        reads_or_refuses(tr.read_experiment, good / "rig")
    finally:
        path.write_text(whole)


@pytest.mark.parametrize("name", ["experiment.toml", "test.csv"])
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_material_test_with_a_spoilt_file_is_read_or_refused(good, name, changes):
    path = good / "test" / name
    whole = path.read_bytes()
    try:
        path.write_bytes(spoilt(whole, changes))
        reads_or_refuses(tr.read_material_experiment, good / "test")
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("name", [one.values[1] for one in READERS])
def test_the_file_that_is_spoilt_is_a_good_one(good, name):
    next(one.values[0] for one in READERS if one.values[1] == name)(good / name)
    tr.read_experiment(good / "rig")
    tr.read_material_experiment(good / "test")
    read_recipe(good / "recipe.toml")
