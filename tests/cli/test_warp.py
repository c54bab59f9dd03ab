"""``tissuereg warp``: from a registration on disk to moved points, surfaces, images and grid transforms."""

import json

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 (its own habit)

import tissuereg as tr
from support.pushes import ELEMENT, MATERIAL, push
from tissuereg.cli import main
from tissuereg.io.triangles_out import write_triangles


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    body = tr.Body(push().mesh, MATERIAL, ELEMENT)
    result = tr.register(body, push().markers(), settings=tr.RegisterSettings(threads=1))
    return result.save(tmp_path_factory.mktemp("registered") / "out", picture=False)


def warped(folder, *words):
    assert main(["warp", str(folder), *map(str, words), "--json", str(folder.parent / "told.json"), "--quiet"]) == 0
    return json.loads((folder.parent / "told.json").read_text(encoding="utf-8"))


def test_points_go_where_the_result_says(folder, tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("x_mm,y_mm,z_mm\n30,30,12\n30,30,20\n30,30,90\n", encoding="utf-8")
    told = warped(folder, "--points", table, "--out", tmp_path / "moved.csv")
    rows = [line.split(",") for line in (tmp_path / "moved.csv").read_text(encoding="utf-8").splitlines()]
    wanted = tr.read_registration(folder).at([[30, 30, 12], [30, 30, 20], [30, 30, 90]])
    assert [row[0] for row in rows] == ["point", "1", "2", "3"]
    assert np.array([row[4:7] for row in rows[1:]], float) == pytest.approx(wanted.mean, abs=1e-6)
    assert rows[3][-1] == "outside the body"
    assert told["schema"] == "tissuereg.warp/1"
    assert told["outside"] == 1
    assert set(told["moved"]) == {"mean_mm", "max_mm"}
    assert "inverse_residual_mm" not in told
    assert told["trusted"] is True


def test_names_of_points_are_kept(folder, tmp_path):
    table = tmp_path / "targets.csv"
    table.write_text("target,x_mm,y_mm,z_mm\ncyst,30,30,12\n", encoding="utf-8")
    warped(folder, "--points", table, "--out", tmp_path / "moved.mrk.json")
    assert list(tr.read_targets(tmp_path / "moved.mrk.json")) == ["cyst"]


def test_a_surface_and_a_label_map_move_alike(folder, tmp_path):
    mesh = push().mesh
    used, corners = np.unique(mesh.surface, return_inverse=True)
    write_triangles(tmp_path / "skin.ply", tr.Triangles(mesh.nodes[used], corners.reshape(-1, 3)))
    told = warped(folder, "--surface", tmp_path / "skin.ply", "--out", tmp_path / "moved.stl")
    assert told["outside"] == 0
    image = sitk.Image([70, 70, 34], sitk.sitkUInt8)
    image.SetOrigin((-5.0, -5.0, -5.0))
    z, y, x = np.meshgrid(*[np.arange(n) - 5.0 for n in (34, 70, 70)], indexing="ij")
    inside = (x >= 0) & (x <= 60) & (y >= 0) & (y <= 60) & (z >= 0) & (z <= 24)
    labels = sitk.GetImageFromArray(inside.astype(np.uint8))
    labels.CopyInformation(image)
    sitk.WriteImage(labels, str(tmp_path / "seg.nrrd"))
    told = warped(folder, "--labels", tmp_path / "seg.nrrd", "--out", tmp_path / "moved.nrrd")
    assert told["inverse_residual_mm"] < 1e-5
    found = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "moved.nrrd")))
    moved = tr.Triangles(mesh.nodes + tr.read_registration(folder).displacement, mesh.surface).volume
    assert found.sum() / inside.sum() == pytest.approx(moved / mesh.volumes.sum(), rel=0.01)


def test_a_grid_needs_no_out_and_says_its_residual(folder, tmp_path, capsys):
    told = warped(folder, "--grid", tmp_path / "field.h5", "--spacing", 3)
    assert "taken for LPS" in " ".join(capsys.readouterr().err.split())
    assert told["inverse_residual_mm"] < 1e-5
    assert sitk.ReadTransform(str(tmp_path / "field.h5")).GetName() == "CompositeTransform"
    words = ("--grid", tmp_path / "field.nrrd", "--spacing", 3, "--std", tmp_path / "sigma.nrrd", "--frame", "RAS")
    told = warped(folder, *words)
    assert told["frame"] == "RAS"
    assert "LPS" not in capsys.readouterr().err
    assert told["written"] == [str(tmp_path / "field.nrrd"), str(tmp_path / "sigma.nrrd")]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "must be given, got none"),
        (("--points", "p.csv", "--labels", "l.nrrd", "--out", "o.csv"), "--points, --labels"),
        (("--points", "p.csv"), "--out must be given"),
        (("--grid", "f.nrrd", "--out", "o.nrrd"), "names the file itself"),
        (("--points", "p.csv", "--out", "o.csv", "--spacing", "2"), "--spacing must come with --grid"),
        (("--points", "p.csv", "--out", "o.csv", "--like", "ct.nrrd"), "--like must come with"),
        (("--points", "p.csv", "--out", "o.csv", "--unit", "cm"), "--unit must come with --surface"),
        (("--points", "p.csv", "--out", "p.csv"), "p.csv"),
        (("--points", "p.csv", "--out", "o.vtu"), "must end in .csv or .mrk.json"),
        (("--points", "p.fcsv", "--out", "o.csv"), "p.fcsv is in RAS, and the mesh states no frame"),
        (("--points", "missing.csv", "--out", "o.csv"), "missing.csv"),
    ],
)
def test_options_that_clash_are_refused_and_nothing_is_written(folder, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.csv").write_text("x_mm,y_mm,z_mm\n30,30,12\n", encoding="utf-8")
    head = "# Markups fiducial file version = 4.11\n# CoordinateSystem = RAS\n"
    (tmp_path / "p.fcsv").write_text(head + "# columns = id,x,y,z,label\n1,30,30,12,cyst\n", encoding="utf-8")
    assert main(["warp", str(folder), *words]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.csv", "p.fcsv"]


def test_a_folder_that_holds_no_registration_is_refused(tmp_path, capsys):
    assert main(["warp", str(tmp_path), "--points", "p.csv", "--out", str(tmp_path / "o.csv")]) == 2
    assert "registration.json" in capsys.readouterr().err
