"""``tissuereg advise markers``: where the next markers should go."""

import csv
import json

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.cli import main
from tissuereg.io.meshes import write_vtu


@pytest.fixture
def folder(tmp_path):
    write_vtu(tmp_path / "body.vtu", block(cells=(3, 2, 4)))
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\ndeep,11,9,13\nside,22,5,25\n")
    return tmp_path


def advised(folder, *more):
    words = [
        "advise",
        "markers",
        *map(str, more),
        "--targets",
        str(folder / "targets.csv"),
        "--out",
        str(folder / "out"),
    ]
    return main([*words, "--number", "4", "--members", "60", "--quiet"])


def test_places_of_a_body_are_listed_with_what_is_expected_then(folder):
    assert advised(folder, folder / "body.vtu") == 0
    answer = json.loads((folder / "out" / "advise.json").read_text())
    assert answer["schema"] == "tissuereg.advise/1"
    assert [set(place) for place in answer["places"]] == [{"x_mm", "y_mm", "z_mm", "expected_std_mm"}] * 4
    with (folder / "out" / "markers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["marker"] for row in rows] == ["M1", "M2", "M3", "M4"]
    mesh = block(cells=(3, 2, 4))
    free = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)]
    for place, row in zip(answer["places"], rows, strict=True):
        point = np.array([place["x_mm"], place["y_mm"], place["z_mm"]])
        assert np.linalg.norm(free - point, axis=1).min() < 1e-9
        assert float(row["x_mm"]) == place["x_mm"]
        both = [float(row["expected_deep_mm"]), float(row["expected_side_mm"])]
        assert place["expected_std_mm"] == pytest.approx(np.sqrt(np.mean(np.square(both))))
    left = [place["expected_std_mm"] for place in answer["places"]]
    assert left == sorted(left, reverse=True)
    assert left[0] > 1.2 * left[-1]


def test_pushes_that_move_the_body_farther_leave_more(folder):
    left = []
    for largest in ("1", "10"):
        assert advised(folder, folder / "body.vtu", "--largest", largest) == 0
        answer = json.loads((folder / "out" / "advise.json").read_text())
        left.append(answer["expected_mm"]["deep"][0])
    # Nothing is measured before the first marker: all is in proportion.
    assert left[1] == pytest.approx(10.0 * left[0], rel=1e-9)


def test_the_shipped_model_needs_no_mesh(folder):
    (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,2,16,24\n")
    assert advised(folder, "--model", "phantom") == 0
    places = json.loads((folder / "out" / "advise.json").read_text())["places"]
    surface = tr.phantom.phantom_mesh().surface_nodes
    nodes = tr.phantom.phantom_mesh().nodes[surface]
    for place in places:
        assert np.linalg.norm(nodes - [place["x_mm"], place["y_mm"], place["z_mm"]], axis=1).min() < 1e-9


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "MESH, --model or --data must be given"),
        (("body.vtu", "--data", "data"), "MESH must be left out with --data"),
        (("--model", "phantom", "--fixed", "plane 0 0 1 0"), "--fixed must come with MESH"),
        (("--model", "phantom", "--largest", "3"), "--largest must be left out"),
        (("missing.vtu",), "missing.vtu"),
    ],
)
def test_what_does_not_go_together_is_refused_and_nothing_is_written(folder, capsys, words, said):
    assert advised(folder, *words) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (folder / "out").exists()
