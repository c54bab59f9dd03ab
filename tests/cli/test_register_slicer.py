"""``tissuereg register`` with points of 3D Slicer, frames, a believed material and weight, and what it writes."""

import contextlib
import io
import json

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json, write_experiment
from support.meshes import block
from support.slicer import fcsv_text, other_frame, write_mrk
from tissuereg.cli import build_parser, main
from tissuereg.cli.options import UsageError
from tissuereg.io.foreign import read_grid
from tissuereg.io.meshes import mesh_arrays, write_mesh_npz, write_vtu
from tissuereg.io.mrk_json import read_mrk_json
from tissuereg.io.tables import write_markers, write_points

TARGETS = {"deep": (18.0, 12.0, 22.0), "high": (12.0, 8.0, 34.0)}


def by_label(names, places):
    return {name: tuple(round(float(x), 6) for x in place) for name, place in zip(names, places, strict=True)}


@pytest.fixture(scope="module")
def event():
    """Where eleven markers of a block sit and where they were seen after a pull at its top, by label."""
    mesh = block()
    middles = mesh.nodes[mesh.surface].mean(axis=1)
    top = mesh.surface[(middles[:, 2] > 39.0) & (middles[:, 0] > 15.0)]
    moved = tr.simulate(mesh, tr.Load(traction=(top, (0.4, 0.1, 0.1))), tr.Material(8.0, 0.45)).displacement
    rng = np.random.default_rng(4)
    nodes = rng.choice(np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes), 11, replace=False)
    seen = mesh.nodes[nodes] + moved[nodes] + 0.05 * rng.standard_normal((11, 3))
    names = [f"F-{i}" for i in range(1, 12)]
    return by_label(names, mesh.nodes[nodes]), by_label(names, seen)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, event):
    """The event in LPS and in RAS: meshes, tables, and points of 3D Slicer in either format."""
    place = tmp_path_factory.mktemp("event")
    sit, seen = event
    mesh = block()
    turned = tr.Mesh(mesh.nodes * (-1.0, -1.0, 1.0), mesh.tets, mesh.node_sets)
    for frame, body, turn in (("lps", mesh, dict), ("ras", turned, other_frame)):
        write_vtu(place / f"{frame}.vtu", body)
        reference, measured = turn(sit), turn(seen)
        table = tr.Markers(list(reference.values()), list(measured.values()), 0.05, list(reference))
        write_markers(place / f"{frame}.csv", table)
        write_points(place / f"{frame}_targets.csv", turn(TARGETS))
        write_mrk(place / f"{frame}_sit.mrk.json", reference, frame.upper())
        write_mrk(place / f"{frame}_seen.mrk.json", measured, frame.upper())
        (place / f"{frame}_seen.fcsv").write_text(fcsv_text(measured, frame.upper()))
        write_mrk(place / f"{frame}_targets.mrk.json", turn(TARGETS), frame.upper())
    return place


def register(capsys, folder, out, *words):
    """Register with files of `folder` by name; return the code, the JSON and standard error."""
    named = [folder / word if (folder / str(word)).is_file() else word for word in words]
    return run_json(capsys, "register", *named, "--quiet", "--out", out)


@pytest.fixture(scope="module")
def plain(folder):
    """The answer from tables, all in LPS, written with the warped body to the folder's ``plain``."""
    files = [folder / "lps.vtu", folder / "lps.csv", "--targets", folder / "lps_targets.csv"]
    words = ["register", *files, "--deformed", "--quiet", "--out", folder / "plain", "--json", folder / "plain.json"]
    with contextlib.redirect_stdout(io.StringIO()):
        assert main([str(word) for word in words]) == 0
    return json.loads((folder / "plain.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "words",
    [
        ["lps.vtu", "lps_sit.mrk.json", "--measured", "lps_seen.mrk.json", "--targets", "lps_targets.mrk.json"],
        ["lps.vtu", "ras_sit.mrk.json", "--measured", "lps_seen.fcsv", "--targets", "ras_targets.mrk.json"],
        ["lps.vtu", "lps_sit.mrk.json", "--measured", "ras_seen.fcsv", "--targets", "lps_targets.csv"],
    ],
    ids=["all LPS", "mixed", "mixed with a table"],
)
def test_points_of_slicer_give_the_answer_of_the_table_whatever_their_frames(capsys, folder, tmp_path, plain, words):
    code, said, err = register(capsys, folder, tmp_path / "out", *words, "--frame", "LPS", "--std", 0.05)
    assert (code, err) == (0, "")
    assert said["targets"] == plain["targets"]
    assert said["markers"] == plain["markers"]


def test_tables_in_another_frame_than_the_mesh_are_turned(capsys, folder, tmp_path, plain):
    words = ["lps.vtu", "ras.csv", "--targets", "ras_targets.csv", "--frame", "LPS", "--tables-frame", "RAS"]
    code, said, err = register(capsys, folder, tmp_path / "out", *words)
    assert (code, err) == (0, "")
    assert said["targets"] == plain["targets"]


def test_a_mesh_in_ras_has_the_same_answer_turned(capsys, folder, tmp_path, plain):
    words = ["ras.vtu", "lps_sit.mrk.json", "--measured", "ras_seen.fcsv", "--targets", "lps_targets.mrk.json"]
    code, said, _ = register(capsys, folder, tmp_path / "out", *words, "--frame", "RAS", "--std", 0.05)
    assert code == 0
    for name, target in plain["targets"].items():
        assert said["targets"][name]["reference_mm"] == list(other_frame(TARGETS)[name])
        turned = np.array(said["targets"][name]["mean_mm"]) * (-1, -1, 1)
        np.testing.assert_allclose(turned, target["mean_mm"], atol=1e-6)
    written = read_mrk_json(tmp_path / "out" / "targets.mrk.json")
    assert (written.frame, said["frame"], plain["frame"]) == ("RAS", "RAS", None)
    assert written.places.tolist() == [target["mean_mm"] for target in said["targets"].values()]
    in_lps = tr.read_targets(tmp_path / "out" / "targets.mrk.json", frame="LPS")
    np.testing.assert_allclose(in_lps["deep"], plain["targets"]["deep"]["mean_mm"], atol=1e-6)


def test_without_a_frame_that_of_the_file_is_taken_and_said_in_one_line(capsys, folder, tmp_path):
    words = ["ras.vtu", "ras_sit.mrk.json", "--measured", "lps_seen.fcsv", "--targets", "lps_targets.mrk.json"]
    code, said, err = register(capsys, folder, tmp_path / "out", *words, "--std", 0.05)
    assert code == 0
    file = folder / "ras_sit.mrk.json"
    assert err == f"note: MESH is taken to be in RAS, the frame of {file}; set --frame to change that\n"
    assert said["targets"]["deep"]["reference_mm"] == list(other_frame(TARGETS)["deep"])
    assert read_mrk_json(tmp_path / "out" / "targets.mrk.json").frame == "RAS"


@pytest.mark.parametrize("option", ["--targets", "--seen"])
def test_a_frame_that_inner_points_alone_state_is_not_guessed_for_the_rest(capsys, folder, tmp_path, plain, option):
    file = folder / "ras_targets.mrk.json"
    code, said, err = register(capsys, folder, tmp_path / "out", "lps.vtu", "lps.csv", option, file)
    assert (code, said["error"], said["where"]) == (2, "UsageError", "--frame")
    wanted = f"--frame must be given: {file} is in RAS, and nothing else says what frame it is in"
    assert (said["message"], err.count("frame must")) == (wanted, 1)
    assert not (tmp_path / "out").exists()
    if option == "--targets":
        code, said, _ = register(capsys, folder, tmp_path / "out", "lps.vtu", "lps.csv", option, file, "--frame", "LPS")
        assert code == 0
        assert said["targets"] == plain["targets"]


def test_a_mesh_that_states_its_frame_needs_no_option_and_none_may_contradict_it(capsys, folder, tmp_path, plain):
    for frame in ("lps", "ras"):
        write_mesh_npz(tmp_path / f"{frame}.npz", tr.read_mesh(folder / f"{frame}.vtu", frame=frame.upper()))
    words = ["ras_sit.mrk.json", "--measured", "ras_seen.fcsv", "--targets", "lps_targets.csv", "--std", 0.05]
    code, said, err = register(capsys, folder, tmp_path / "out", tmp_path / "lps.npz", *words)
    assert (code, err, said["frame"]) == (0, "", "LPS")
    assert said["targets"] == plain["targets"]
    words = ["lps.csv", "--tables-frame", "LPS", "--targets", "lps_targets.mrk.json"]
    code, said, err = register(capsys, folder, tmp_path / "out", tmp_path / "ras.npz", *words)
    assert (code, err, said["frame"]) == (0, "", "RAS")
    turned = np.array(said["targets"]["deep"]["mean_mm"]) * (-1, -1, 1)
    np.testing.assert_allclose(turned, plain["targets"]["deep"]["mean_mm"], atol=1e-6)
    code, said, _ = register(capsys, folder, tmp_path / "no", tmp_path / "ras.npz", "ras.csv", "--frame", "LPS")
    assert (code, said["error"]) == (2, "FormatError")
    assert "ras.npz is in RAS, --frame LPS (frame= in Python) contradicts it" in said["message"]


def test_a_frame_of_an_archive_must_be_one(tmp_path):
    np.savez(tmp_path / "bad.npz", **{**mesh_arrays(block()), "frame": "IJK"})
    with pytest.raises(tr.errors.FormatError, match="must be one of LPS, RAS, got 'IJK'"):
        tr.read_mesh(tmp_path / "bad.npz")


def test_a_wrong_frame_is_refused_with_the_right_one_named(capsys, folder, tmp_path):
    """The block lies beside the origin: points in the other frame are nowhere near it."""
    words = ["lps.vtu", "lps_sit.mrk.json", "--measured", "lps_seen.fcsv", "--frame", "RAS"]
    code, said, _ = register(capsys, folder, tmp_path / "out", *words)
    assert code == 2
    assert "frame: all markers if read as (-x, -y, z) fit better" in said["message"]


def test_registered_places_are_written_for_slicer_beside_the_table(folder, plain):
    points = read_mrk_json(folder / "plain" / "targets.mrk.json")
    assert points.frame == "LPS"  # which Slicer takes for granted, of the .vtu too
    assert points.names == tuple(plain["targets"])
    assert points.places.tolist() == [target["mean_mm"] for target in plain["targets"].values()]
    (markup,) = json.loads((folder / "plain" / "targets.mrk.json").read_text(encoding="utf-8"))["markups"]
    assert markup["name"] == "targets"
    for point, target in zip(markup["controlPoints"], plain["targets"].values(), strict=True):
        axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
        flag = "" if target["flag"] is None else f"{target['flag']}; "
        assert point["description"] == f"{flag}90 % region with half-axes {axes} mm"


def test_a_frame_of_an_experiment_takes_targets_of_slicer(capsys, tmp_path):
    rig = write_experiment(tmp_path / "rig")
    write_mrk(tmp_path / "more.mrk.json", {"more": (-15.0, -10.0, 25.0)}, "RAS")
    words = ["register", rig, "--case", "lean", "--time", 11, "--targets", tmp_path / "more.mrk.json"]
    _, said, err = run_json(capsys, *words, "--frame", "LPS", "--quiet", "--out", tmp_path / "out")
    assert err == ""
    assert said["targets"]["more"]["reference_mm"] == [15.0, 10.0, 25.0]
    assert list(said["targets"]) == ["deep", "more"]


# --- what is written ---


def test_fields_say_whether_the_displacement_warps_them(folder, plain):
    out = folder / "plain"
    body, moved = (read_grid(out / f"{name}.vtu", "mesh") for name in ("registered", "registered_deformed"))
    assert b'Name="points_are_undeformed_warp_by_displacement_mm"' in (out / "registered.vtu").read_bytes()
    assert b'Name="points_are_warped_by_displacement_mm_already"' in (out / "registered_deformed.vtu").read_bytes()
    assert np.array_equal(body.points, block().nodes)
    assert np.array_equal(moved.points, body.points + body.point_data["displacement_mm"])
    assert set(body.point_data) == set(moved.point_data) >= {"displacement_mm", "std_mm", "fixed"}
    assert np.linalg.norm(moved.points - body.points, axis=1).max() == plain["body"]["largest_mm"]
    assert tr.read_mesh(out / "registered_deformed.vtu").n_tets == block().n_tets


def test_a_body_that_is_inside_out_can_be_written_where_it_is(tmp_path):
    mesh = block()
    write_vtu(tmp_path / "b.vtu", mesh, places=mesh.nodes * (1.0, 1.0, -1.0))
    assert np.array_equal(read_grid(tmp_path / "b.vtu", "mesh").points, mesh.nodes * (1.0, 1.0, -1.0))
    with pytest.raises(tr.errors.ShapeError, match="places"):
        write_vtu(tmp_path / "b.vtu", mesh, places=mesh.nodes[1:])


def test_an_answer_not_to_be_trusted_is_written_said_last_and_has_its_own_code(capsys, folder, event, tmp_path):
    seen = event[1]
    wrong = {**seen, "F-3": tuple(x + s for x, s in zip(seen["F-3"], (4.0, -4.0, 4.0), strict=True))}
    write_mrk(tmp_path / "wrong.mrk.json", wrong, not_seen=["F-5"])
    files = [folder / "lps.vtu", folder / "lps_sit.mrk.json", "--measured", tmp_path / "wrong.mrk.json"]
    words = [*files, "--targets", folder / "lps_targets.csv", "--std", 0.05, "--out", tmp_path / "out", "--quiet"]
    code, out, _ = run(capsys, "register", *words, "--json", tmp_path / "said.json")
    assert code == 4
    assert json.loads((tmp_path / "said.json").read_text(encoding="utf-8"))["schema"] == "tissuereg.registration/1"
    assert not (tmp_path / "out" / "registered_deformed.vtu").exists()
    assert out.splitlines()[-1].startswith("Do not trust this registration: wrong marker")
    told = json.loads((tmp_path / "out" / "registration.json").read_text(encoding="utf-8"))
    assert told["trust"]["ok"] is False
    assert {"marker": "F-5", "reason": "not seen"} in told["markers"]["dropped"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Do not trust this registration." in page
    (markup,) = json.loads((tmp_path / "out" / "targets.mrk.json").read_text(encoding="utf-8"))["markups"]
    for point in markup["controlPoints"]:
        assert point["description"].startswith("do not trust this registration; ")


def test_the_codes_stand_in_the_help(capsys):
    for words in (["--help"], ["register", "--help"]):
        text = " ".join(run(capsys, *words)[1].split())
        assert "written" in text[text.index("4") - 60 :]
        assert "trusted" in text


# --- what is believed ---


def sagged(tmp_path, gravity, young, poisson, density):
    """Write a block and markers that moved by a weight alone."""
    mesh, material = block(), tr.Material(young, poisson, density=density)
    weight = np.array(gravity) * density * 1e-6
    moved = tr.simulate(mesh, tr.Load(body_force=weight), material, element="tet4-averaged").displacement
    nodes = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::7]
    markers = tr.Markers(mesh.nodes[nodes], (mesh.nodes + moved)[nodes], 0.05)
    write_vtu(tmp_path / "mesh.vtu", mesh)
    write_markers(tmp_path / "markers.csv", markers)
    write_points(tmp_path / "targets.csv", TARGETS)
    return ["register", tmp_path / "mesh.vtu", tmp_path / "markers.csv", "--targets", tmp_path / "targets.csv"]


def test_a_believed_weight_explains_a_body_that_sags(capsys, tmp_path):
    words = [*sagged(tmp_path, (-9810.0, 0.0, 0.0), 6.0, 0.4, 1.2), "--quiet", "--out", tmp_path / "out"]
    told = ["--young", 6, "--poisson", 0.4, "--gravity", "-9810 0 0", "--density", 1.2]
    mesh, markers = tr.read_mesh(tmp_path / "mesh.vtu"), tr.read_markers(tmp_path / "markers.csv")
    code, said, _ = run_json(capsys, *words, *told)
    assert (code, said["contacts"]) == (0, [])
    assert said["markers"]["before_rms_mm"] < 1e-5
    sag = np.sqrt(np.mean(np.sum((markers.measured - markers.reference) ** 2, axis=1)))
    assert sag > 0.5
    _, lighter, _ = run_json(capsys, *words, *told[:-2])  # of water's density, a sixth less of the sag
    assert lighter["markers"]["before_rms_mm"] == pytest.approx(sag / 6.0, rel=0.1)
    material = tr.Material(young=6.0, poisson=0.4, density=1.2)
    load = tr.Load(body_force=material.weight((-1.0, 0.0, 0.0)))
    result = tr.register(tr.Body(mesh, material=material), markers, targets=TARGETS, load=load)
    assert said["targets"] == result.to_json()["targets"]


def test_a_believed_modulus_scales_forces_alone(capsys, folder, tmp_path, plain):
    code, said, _ = register(
        capsys, folder, tmp_path / "out", "lps.vtu", "lps.csv", "--targets", "lps_targets.csv", "--young", 20
    )
    assert code == 0
    assert [contact["force_mN"] for contact in said["contacts"]] == pytest.approx(
        [2.0 * contact["force_mN"] for contact in plain["contacts"]], rel=1e-6
    )
    for name, target in plain["targets"].items():
        assert said["targets"][name]["mean_mm"] == pytest.approx(target["mean_mm"], abs=1e-6)


# --- words ---


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lps.csv", "--density", 1.1], "--density must come with --gravity"),
        (["lps.csv", "--gravity", "0 0"], "must be three numbers, 'gx gy gz', got '0 0'"),
        (["lps.csv", "--gravity", "0 0 down"], "must be a finite number, got 'down'"),
        (["lps.csv", "--gravity", "0 0 -9.81"], "must be in mm/s^2, of 20 or more (that of the earth is 9810)"),
        (["lps.csv", "--gravity", "0 0 -9810", "--simulation", "u.npz"], "left out with --simulation"),
        (["lps.csv", "--young", 0], "must be a finite number greater than 0, in kPa, got 0"),
        (["lps.csv", "--poisson", 0.5], "`poisson` must be in (-1, 0.5)"),
        (["lps.csv", "--tables-frame", "RAS"], "--tables-frame must come with --frame"),
        (["lps.csv", "--frame", "IJK"], "invalid choice: 'IJK'"),
        (["lps.csv", "--measured", "lps_seen.fcsv"], "the reference one is"),
        (["lps_sit.mrk.json"], "the measured one is missing"),
        (["--surface", "lps.csv", "--measured", "lps_seen.fcsv"], "--measured must come with MARKERS"),
        (["lps_targets.mrk.json", "--measured", "lps_seen.fcsv"], "every label in"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, list) else "",
)
def test_bad_words_exit_with_two_and_write_nothing(capsys, folder, tmp_path, words, message):
    code, said, _ = register(capsys, folder, tmp_path / "out", "lps.vtu", *words)
    assert code == 2
    assert message in said["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("word", ["--young", "--poisson", "--gravity", "--density", "--measured"])
def test_an_experiment_states_its_own_beliefs(capsys, tmp_path, word):
    rig = write_experiment(tmp_path / "rig")
    value = {"--gravity": "0 0 -9810", "--measured": tmp_path / "m.fcsv"}.get(word, 0.4)
    words = ["register", rig, "--case", "lean", "--time", 11, word, value, "--out", tmp_path / "out"]
    code, said, _ = run_json(capsys, *words)
    assert (code, said["where"]) == (2, word)
    assert "must be left out with an experiment" in said["message"]


def test_points_of_slicer_are_never_replaced(capsys, folder, event, tmp_path):
    sit, seen = event
    write_vtu(tmp_path / "mesh.vtu", block())
    write_mrk(tmp_path / "sit.mrk.json", sit)
    measured = write_mrk(tmp_path / "targets.mrk.json", seen)
    before = measured.read_bytes()
    files = [tmp_path / "mesh.vtu", tmp_path / "sit.mrk.json", "--measured", measured]
    code, said, _ = run_json(capsys, "register", *files, "--out", tmp_path)
    assert (code, said["where"]) == (2, str(measured))
    assert measured.read_bytes() == before


def test_the_frame_is_one_of_coordinates_and_the_tracker_has_an_option_of_its_own(capsys):
    line = ["register", "m.vtu", "m.csv", "--out", "o"]
    args = build_parser().parse_args([*line, "--frame", "RAS", "--tracker", "drifts"])
    assert (args.tracker, args.frame) == ("drifts", "RAS")
    for words in (["--frame", "drifts"], ["--tracker", "known"]):
        with pytest.raises(UsageError, match="invalid choice"):
            build_parser().parse_args([*line, *words])
