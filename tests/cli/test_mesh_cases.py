"""Mesh files of others that once were refused, or read wrongly without a word."""

import warnings

import pytest

import tissuereg as tr
from support.files import run

VOLUME = 133865.0


@pytest.mark.parametrize(
    ("name", "frame", "said"),
    [
        ("slicer-tets/liver_slicer.vtk", "RAS", ""),
        ("slicer-tets/liver_slicer_zlib.vtu", "RAS", ""),
        ("vtu-pieces/pieces.vtu", None, "88 nodes lay where another node is"),
        ("vtk-types/organ_int64.vtk", None, ""),
        ("gmsh-partial/partial41.msh", None, ""),
        ("coincident/tumour.vtu", None, "76 nodes lay where another node is"),
        ("left-handed/left.vtu", None, "all 5880 tetrahedra were left-handed"),
    ],
)
def test_a_mesh_of_others_is_the_organ(shared_data, name, frame, said):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mesh = tr.read_mesh(shared_data / "cases" / name)
    assert (mesh.n_nodes, mesh.n_tets, len(mesh.fixed_nodes), mesh.frame) == (1320, 5880, 165, frame)
    assert mesh.volumes.sum() == pytest.approx(VOLUME, abs=0.5)
    assert said in "".join(str(one.message) for one in told)
    assert bool(said) == bool(told)


def test_a_body_that_is_held_everywhere_is_refused(shared_data, capsys, tmp_path):
    cases = shared_data / "cases"
    words = ["register", cases / "organ.vtu", cases / "markers.csv", "--fixed", "plane 0 0 1 0 100"]
    code, _, err = run(capsys, *words, "--out", tmp_path / "out")
    assert (code, "every boundary triangle is held" in err, "Traceback" in err) == (2, True, False)


def test_a_frame_that_contradicts_the_file_is_refused(shared_data, capsys, tmp_path):
    cases = shared_data / "cases"
    words = ["register", cases / "slicer-tets" / "liver_slicer.vtk", cases / "markers.csv", "--frame", "LPS"]
    code, _, err = run(capsys, *words, "--out", tmp_path / "out")
    assert code == 2
    assert "is in RAS" in " ".join(err.split())
