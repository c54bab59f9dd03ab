"""Files that are nearly right, with bytes flipped, ends cut, lines exchanged: read, or refused by an error of ours."""

import hashlib
import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import tissuereg as tr
from support.files import EXPERIMENT, FIDUCIALS, GOOD_MARKERS, GOOD_RECORDING, TABLES, write_experiment, write_problem
from support.grids import write_appended_vtu, write_grid, write_modern_vtk, write_xdmf
from support.meshes import block
from support.recordings import ANY_COLUMNS, ANY_TABLE, MOTIVE, NDI_ROWS, NDI_TRACK, TRC, c3d_bytes, plus_text
from support.spoilt import CHANGES, FUZZED, reads_or_refuses, spoilt
from tissuereg.io.cache import keep_entry, read_entry
from tissuereg.io.meshes import write_vtu
from tissuereg.io.mrk_json import write_mrk_json
from tissuereg.io.problems import read_problem, read_simulation, read_simulations, read_variants
from tissuereg.io.surfaces import read_triangles
from tissuereg.io.tables import read_reference
from tissuereg.registration.learned.card import CARD_SCHEMA, MODEL_FILES, check_files, read_card
from tissuereg.simulation.dataset import make_dataset
from tissuereg.simulation.recipe import read_recipe

SURFACES = (
    "body.stl",
    "letters.stl",
    "body.ply",
    "bytes.ply",
    "body.obj",
    "body.off",
    "hollow.off",
    "body.vtu",
    "body.vtk",
    "body.msh",
)

GRIDS = (
    "bytes.vtk", "modern.vtk", "zlib.vtu", "lzma.vtu", "lz4.vtu", "two.msh", "four.msh", "eight.msh", "mesh.xdmf",
)  # fmt: skip

#: Recordings of trackers, and what must be said with each.
RECORDINGS = {
    "recording.csv": {},
    "motive.csv": {"offsets": {"plate": (1.0, 0.0, 0.0)}},
    "track.csv": {"rate_hz": 60.0},
    "rows.csv": {"rate_hz": 60.0},
    "tool.igs.mha": {},
    "floats.c3d": {},
    "whole.c3d": {},
    "dec.c3d": {},
    "markers.trc": {},
    "any.csv": {"columns": ANY_COLUMNS},
}

ENTRY = bytes(range(200))


#: All columns that markers may have.
WIDE_MARKERS = (
    "marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm,std_mm,std_x_mm,std_y_mm,std_z_mm\n"
    "P1,30,10,40,31,10,40,0.1,,,0.3\nP2,0,10,40,1,10,40,,0.1,0.1,0.1\nP3,15,0,20,,0,20,0.2,,,\n"
)

#: A surface with a hollow face of five corners.
HOLLOW = "OFF\n6 3 0\n0 0 0\n30 0 0\n15 10 0\n30 20 0\n0 20 0\n9 9 9\n5 4 3 2 1 0\n3 0 1 5\n4 1 2 3 5\n"

#: Points as 3D Slicer exports them to a table.
CONTROL_POINTS = (
    'label\tr\ta\ts\tdefined\tdescription\nP1\t30\t10\t40\t1\t"at the rim"\nP2\t\t\t\t0\t\nP3\t15\t0\t20\t1\t\n'
)

#: All tables that a recipe may have.
RECIPE = """\
seed = 3
[mesh]
file = "mesh.vtu"
fixed = "plane 0 0 1 0 0.1"
[material]
young_kpa = [5.0, 15.0]
poisson = 0.45
[data]
members = 12
chunk = 6
element = "tet10"
largest_mm = [1.0, 9.0]
n_patches = [1, 2]
radius_mm = [10.0, 20.0]
body_force_share = 0.5
[pairs]
members = 4
element = "tet10"
young_log_std = 0.2
load_tilt_deg = 4.0
inclusion_share = 0.5
inclusion_radius_mm = [6.0, 9.0]
inclusion_contrast = [2.0, 3.0]
[train]
epochs = 3
"""

#: What an experiment may say besides `EXPERIMENT`.
MORE = """
[gravity]
direction = [0.0, 0.0, -1.0]
g_mm_per_s2 = 9810.0
in_reference = false
[[effect]]
id = "inclusion"
centre_mm = [15.0, 10.0, 20.0]
semi_axes_mm = [8.0, 7.0, 6.0]
contrast = 3.0
[[effect]]
id = "stiffening"
law = "yeoh"
c2_over_c1 = 0.5
c3_over_c1 = 0.1
[[effect]]
id = "relaxation"
g = [0.3, 0.1]
tau_s = [1.0, 10.0]
[[effect]]
id = "softening"
r = 2.0
m_kpa = 1.0
[[effect]]
id = "swelling"
linear_strain = 0.01
from_time_s = 0.0
to_time_s = 10.0
[[effect]]
id = "detachment"
boundary = "base"
azimuth_deg = 20.0
share = 0.1
[[effect]]
id = "actuator_direction"
actuator = "push"
rotation_deg = [0.0, 0.0, 5.0]
[[effect]]
id = "frame"
rotation_deg = [1.0, 0.0, 0.0]
shift_mm = [0.1, 0.0, 0.0]
[[effect]]
id = "marker_swap"
markers = ["P1", "P2"]
from_time_s = 10.5
[[actuator]]
name = "pull"
nodes = { centre_mm = [0.0, 10.0, 40.0], radius_mm = 8.0 }
kind = "force"
edge_std_mm = 0.5
"""

FORCED = "case,time_s,actuator,x_mN,y_mN,z_mN\nlean,10.0,pull,0,0,0\nlean,11.0,pull,20,0,0\n"


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """A folder with one good file of every kind."""
    folder = tmp_path_factory.mktemp("good")
    mesh = block(cells=(1, 1, 2))
    write_vtu(folder / "mesh.vtu", mesh)
    write_grids(folder, mesh)
    np.savez(folder / "mesh.npz", nodes_mm=mesh.nodes, tets=mesh.tets, fixed_nodes=mesh.fixed_nodes)
    write_problem(folder / "problem.npz")
    np.savez(folder / "simulation.npz", displacement_mm=np.zeros((3, 3)))
    np.savez(folder / "simulations.npz", times_s=[0.0, 1.0], displacement_mm=np.zeros((2, 3, 3)))
    np.savez(folder / "variants.npz", displacement_mm=np.zeros((4, 3, 3)))
    (folder / "recording.csv").write_text(GOOD_RECORDING)
    write_recordings(folder)
    (folder / "markers.csv").write_text(GOOD_MARKERS)
    (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,1,2,3\ndeep,4,5,6\n")
    (folder / "surface.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n4,5,6\n7,8,9\n")
    (folder / "sit.fcsv").write_text(FIDUCIALS)
    (folder / "points.tsv").write_text(CONTROL_POINTS)
    write_mrk_json(folder / "targets.mrk.json", {"lesion": ((1, 2, 3), "found"), "deep": ((4, 5, 6), "")}, "RAS")
    body = trimesh.Trimesh(mesh.nodes, mesh.surface, process=False)
    for suffix in ("stl", "ply", "obj", "off"):
        body.export(folder / f"body.{suffix}", **({"encoding": "ascii"} if suffix == "ply" else {}))
    body.export(folder / "letters.stl", file_type="stl_ascii")
    body.export(folder / "bytes.ply")
    (folder / "hollow.off").write_text(HOLLOW)
    for suffix in ("vtu", "vtk", "msh"):
        write_grid(folder / f"body.{suffix}", mesh.nodes, [("triangle", mesh.surface)])
    (folder / "wide.csv").write_text(WIDE_MARKERS)
    write_model(folder, mesh)
    write_cached(folder)
    (folder / "recipe.toml").write_text(
        'seed = 3\n[mesh]\nfile = "mesh.vtu"\n[material]\nyoung_kpa = [5.0, 15.0]\npoisson = 0.45\n'
        "[data]\nmembers = 12\nchunk = 6\nlargest_mm = [1.0, 9.0]\n[pairs]\nmembers = 0\n"
    )
    make_dataset(read_recipe(folder / "recipe.toml"), folder / "data", threads=1)
    (folder / "whole.toml").write_text(RECIPE)
    write_experiment(folder / "rig")
    write_experiment(folder / "wide-rig", toml=EXPERIMENT + MORE, forces_applied=FORCED)
    test = folder / "test"
    test.mkdir()
    (test / "experiment.toml").write_text('kind = "material-test"\n[material]\nyoung_kpa = 3.0\npoisson = 0.49\n')
    rows = "".join(f"a,tension,,,{1 + 0.1 * i:.1f},{0.2 * i:.1f}\n" for i in range(1, 6))
    (test / "test.csv").write_text("specimen,mode,rate_per_s,time_s,stretch_or_shear,stress_kPa\n" + rows)
    return folder


def write_recordings(folder):
    """Recordings of trackers, in the forms in which they are exported."""
    texts = {
        "motive.csv": MOTIVE,
        "track.csv": NDI_TRACK,
        "rows.csv": NDI_ROWS,
        "markers.trc": TRC,
        "any.csv": ANY_TABLE,
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 2, 3] = (1.0, 2.0, 3.0)
    (folder / "tool.igs.mha").write_text(plus_text({"Tool": poses}))
    for name, how in {"floats": {}, "whole": {"floats": False, "order": ">"}, "dec": {"order": "dec"}}.items():
        (folder / f"{name}.c3d").write_bytes(c3d_bytes(poses[:, :2, :3], ["P1", "P2"], **how))


def write_grids(folder, mesh):
    """A body in the forms that other programs write."""
    cells = [("triangle", mesh.surface), ("tetra", mesh.tets)]
    held = {"fixed": (mesh.nodes[:, 2] == 0.0).astype(float)}
    write_grid(folder / "ascii.vtu", mesh.nodes, cells[1:], held)
    write_grid(folder / "mesh.vtk", mesh.nodes, cells[1:], held)
    write_grid(folder / "bytes.vtk", mesh.nodes, cells[1:], held, binary=True)
    write_modern_vtk(folder / "modern.vtk", mesh.nodes, mesh.tets)
    for packed in ("zlib", "lzma", "lz4"):
        write_appended_vtu(folder / f"{packed}.vtu", mesh.nodes, mesh.tets, packed)
    for name, version, binary in (
        ("mesh", "2.2", False),
        ("two", "2.2", True),
        ("four", "4.1", False),
        ("eight", "4.1", True),
    ):
        how = {"version": version, "binary": binary, "groups": (7, 1), "names": '1\n2 7 "fixed"'}
        write_grid(folder / f"{name}.msh", mesh.nodes, cells, held, **how)
    write_xdmf(folder / "mesh.xdmf", mesh.nodes, cells, (np.arange(len(mesh.surface)) % 3))


def write_model(folder, mesh):
    """A model that is whole but for its networks, which no card can spoil."""
    (folder / "model").mkdir()
    for name in MODEL_FILES:
        (folder / "model" / name).write_bytes(name.encode())
    files = {name: hashlib.sha256(name.encode()).hexdigest() for name in MODEL_FILES}
    square = [[1.0, 0.1], [0.1, 2.0]]
    card = {
        "schema": CARD_SCHEMA,
        "kind": "gnn-vae",
        "mesh_digest": mesh.digest(),
        "n_nodes": mesh.n_nodes,
        "n_latent": 2,
        "members": 60,
        "errors_mm": {"test": 0.2, "pca": 0.3},
        "prior": {"mean": [0.0, 0.1], "covariance": square, "mismatch_covariance": square},
        "files": files,
    }
    (folder / "model.json").write_text(json.dumps(card))


def read_model(path):
    """Read a card as that of the model, and look at its files."""
    folder = path.parent / "model"
    shutil.copy(path, folder / "model.json")
    check_files(folder, read_card(folder))


def write_cached(folder):
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("TISSUEREG_CACHE", str(folder / "cache"))
        keep_entry("bank_one", ENTRY, 3)
    shutil.copy(folder / "cache" / "bank_one.cached", folder / "bank_one.cached")


def read_cached(path):
    """Read a file as an entry of a cache: it is absent, or what was kept."""
    shutil.copy(path, path.parent / "cache" / "bank_one.cached")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("TISSUEREG_CACHE", str(path.parent / "cache"))
        found = read_entry("bank_one")
    assert found == (ENTRY if path.read_bytes() == (path.parent / path.name[-15:]).read_bytes() else None)


#: A reader, and the files that it is given.
READERS = [
    pytest.param(tr.read_mesh, "mesh.vtu", id="mesh.vtu"),
    pytest.param(tr.read_mesh, "ascii.vtu", id="ascii.vtu"),
    pytest.param(tr.read_mesh, "mesh.vtk", id="mesh.vtk"),
    pytest.param(tr.read_mesh, "mesh.msh", id="mesh.msh"),
    pytest.param(tr.read_mesh, "mesh.npz", id="mesh.npz"),
    pytest.param(read_problem, "problem.npz", id="problem.npz"),
    pytest.param(read_simulation, "simulation.npz", id="simulation.npz"),
    pytest.param(read_simulations, "simulations.npz", id="simulations.npz"),
    pytest.param(read_variants, "variants.npz", id="variants.npz"),
    *(pytest.param(partial(tr.read_recording, **how), name, id=name) for name, how in RECORDINGS.items()),
    pytest.param(read_reference, "wide.csv", id="reference"),
    pytest.param(tr.read_markers, "markers.csv", id="markers.csv"),
    pytest.param(tr.read_targets, "targets.csv", id="targets.csv"),
    pytest.param(tr.read_surface, "surface.csv", id="surface.csv"),
    pytest.param(tr.read_targets, "sit.fcsv", id="sit.fcsv"),
    pytest.param(tr.read_surface, "points.tsv", id="points.tsv"),
    pytest.param(tr.read_targets, "targets.mrk.json", id="targets.mrk.json"),
    *(pytest.param(tr.read_mesh, name, id=name) for name in GRIDS),
    pytest.param(tr.read_markers, "wide.csv", id="wide.csv"),
    *(pytest.param(read_triangles, name, id=name) for name in SURFACES),
    pytest.param(read_recipe, "recipe.toml", id="recipe.toml"),
    pytest.param(read_recipe, "whole.toml", id="whole.toml"),
    pytest.param(read_model, "model.json", id="model.json"),
    pytest.param(read_cached, "bank_one.cached", id="bank_one.cached"),
]


@pytest.mark.parametrize(("read", "name"), READERS)
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_spoilt_file_is_read_or_refused(good, read, name, changes):
    path = good / f"spoilt-{name}"
    path.write_bytes(spoilt((good / name).read_bytes(), changes))
    reads_or_refuses(read, path)


def read_data(folder):
    """Read all of a data set."""
    data = tr.open_dataset(folder)
    assert data.displacement[:].shape == (len(data), data.card["mesh"]["n_nodes"], 3)
    assert len(data.parameters[:]) == len(data)
    assert len(data.index) == len(data)
    assert data.mesh.n_nodes == data.card["mesh"]["n_nodes"]
    assert set(data.split) == {"train", "valid", "test"}


FOLDERS = [
    *(pytest.param(read_data, f"data/{name}", id=f"data-{name}") for name in ("dataset.json", "chunk_0000.h5")),
    *(pytest.param(tr.read_experiment, f"rig/{name}", id=f"rig-{name}") for name in ("experiment.toml", *TABLES)),
    *(
        pytest.param(tr.read_experiment, f"wide-rig/{name}", id=f"wide-rig-{name}")
        for name in ("experiment.toml", "forces_applied.csv")
    ),
    *(
        pytest.param(tr.read_material_experiment, f"test/{name}", id=f"test-{name}")
        for name in ("experiment.toml", "test.csv")
    ),
]


@pytest.mark.parametrize(("read", "name"), FOLDERS)
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_folder_with_a_spoilt_file_is_read_or_refused(good, read, name, changes):
    path = good / name
    whole = path.read_bytes()
    try:
        path.write_bytes(spoilt(whole, changes))
        reads_or_refuses(read, path.parent)
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("name", [one.values[1] for one in READERS])
def test_the_file_that_is_spoilt_is_a_good_one(good, name):
    next(one.values[0] for one in READERS if one.values[1] == name)(good / name)
    tr.read_experiment(good / "rig")
    tr.read_experiment(good / "wide-rig")
    tr.read_material_experiment(good / "test")
    read_recipe(good / "recipe.toml")
    read_data(good / "data")
