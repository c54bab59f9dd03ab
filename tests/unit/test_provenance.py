"""How an answer was made: date, call, files with their hashes, and every warning, also of what was read before."""

import hashlib
import json
import warnings
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

import tissuereg as tr
from support.files import GOOD_MARKERS, run_json, write_experiment
from support.meshes import block
from tissuereg.errors import UnitWarning
from tissuereg.io.meshes import write_vtu

OUTSIDE = "target 'deep' lies 2.1 mm outside the mesh"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a mesh, markers, targets and points of the surface."""
    folder = tmp_path_factory.mktemp("files")
    mesh = block()
    write_vtu(folder / "mesh.vtu", mesh)
    (folder / "markers.csv").write_text(GOOD_MARKERS)
    (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\ndeep,15,10,-2\n")
    rows = [",".join(map(str, place)) for place in mesh.nodes[mesh.surface_nodes].tolist()]
    (folder / "surface.csv").write_text("x_mm,y_mm,z_mm\n" + "\n".join(rows) + "\n")
    return folder


def hashed(folder, *names):
    return [{"path": name, "sha256": hashlib.sha256((folder / name).read_bytes()).hexdigest()} for name in names]


def test_a_command_states_itself_its_files_and_its_warnings(files, tmp_path, capsys):
    mesh, markers, targets = (str(files / name) for name in ("mesh.vtu", "markers.csv", "targets.csv"))
    words = ("register", mesh, markers, "--targets", targets, "--threads", "1", "--out", tmp_path / "out", "--quiet")
    code, said, _ = run_json(capsys, *words)
    assert code == 0
    made = said["provenance"]
    assert made["command"] == f"tissuereg register {mesh} {markers} --targets {targets}"
    assert made["inputs"] == hashed(files, "mesh.vtu", "markers.csv", "targets.csv")
    assert [text for text in made["warnings"] if text.startswith(OUTSIDE)]
    assert made["version"] == tr.__version__
    assert abs(datetime.fromisoformat(made["date"]) - datetime.now(UTC)) < timedelta(minutes=5)
    assert {"contacts", "tracker", "body"} <= set(made["settings"])
    assert json.loads((tmp_path / "out" / "registration.json").read_text())["provenance"] == made
    assert made["use"] == "For research use. Not a medical device; no patient data have been tried."
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for words in (
        *(one["sha256"] for one in made["inputs"]),
        made["date"],
        "lies 2.1 mm outside",
        "0.1 mm of a marker",
    ):
        assert words in page
    assert "Not a medical device; no patient data have been tried." in page


def test_results_in_python_know_the_files_of_their_arguments_also_derived_ones(files):
    mesh = tr.read_mesh(files / "mesh.vtu").in_frame("LPS").with_node_set("top", [0])
    targets = {**tr.read_targets(files / "targets.csv"), "more": (15.0, 10.0, 20.0)}
    markers = tr.read_markers(files / "markers.csv").only([0, 1])
    with pytest.warns(UserWarning, match=OUTSIDE):
        made = tr.register(tr.Body(mesh), markers, targets=targets).to_json()["provenance"]
    assert made["inputs"] == hashed(files, "mesh.vtu", "markers.csv", "targets.csv")
    assert made["command"].startswith("tissuereg.register(mesh=Mesh(")
    assert "targets=(deep, more)" in made["command"].replace("'", "")
    surface = tr.SurfacePoints(tr.read_surface(files / "surface.csv"))
    plain = tr.register(block(), surface=surface).to_json()["provenance"]
    assert plain["inputs"] == hashed(files, "surface.csv")
    places = block().nodes[[50, 60]]
    assert tr.register(block(), (places, places)).to_json()["provenance"]["inputs"] == []


def test_a_warning_is_told_by_every_answer_that_it_concerns_also_where_it_is_not_shown_again(files):
    mesh, markers = tr.read_mesh(files / "mesh.vtu"), tr.read_markers(files / "markers.csv")
    with pytest.warns(UnitWarning):
        hard = tr.Body(mesh, tr.Material(young=1e6))
    targets = tr.read_targets(files / "targets.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        registrar = tr.Registrar(hard, markers, targets=targets)
        answers = [registrar.register(markers.measured), registrar.register(markers), tr.register(mesh, markers)]
    told = [answer.provenance.warnings for answer in answers]
    assert told[0] == told[1]
    assert [text.split(" ")[0] for text in told[0]] == ["`young`", "target"]
    assert told[2] == ()


def test_a_shipped_model_is_among_the_files(tmp_path):
    mesh = tr.phantom.phantom_mesh()
    places = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::300]]
    for _ in range(2):  # the second time the model is kept
        made = tr.Registrar(mesh, places, "phantom").register(places).provenance
        assert {"model.json", "decoder.onnx", "encoder.onnx"} <= {one.path for one in made.inputs}


def test_a_frame_of_an_experiment_names_the_files_of_the_experiment(tmp_path):
    experiment = tr.read_experiment(write_experiment(tmp_path / "rig"))
    made = tr.register_frame(experiment, "lean", 11.0).provenance
    assert {one.path for one in made.inputs} >= {"experiment.toml", "mesh.vtu", "markers.csv", "actuators.csv"}
    assert made.command.startswith("tissuereg.register_frame(")
