"""Static problems and displacement fields in .npz files."""

import numpy as np
import pytest

from support.files import problem_arrays, write_problem
from tissuereg.errors import FormatError, MaterialError, MeshError
from tissuereg.io.problems import read_problem, read_simulation, write_solution


def test_the_reference_files_are_read(shared_data):
    problem = read_problem(shared_data / "reference" / "dome_4k_pull.npz")
    assert (problem.mesh.n_nodes, problem.mesh.n_tets, len(problem.mesh.fixed_nodes)) == (4227, 19083, 728)
    assert problem.material.young == 10.0
    assert abs(np.linalg.norm(problem.load.forces.sum(axis=0)) - 2780) < 10  # 2.78 N
    assert np.linalg.norm(problem.reference, axis=1).max() == pytest.approx(9.981, abs=1e-3)


def test_moduli_may_be_one_value_or_one_a_tet(tmp_path):
    for young in (10.0, [10.0], np.full(360, 10.0)):
        problem = read_problem(write_problem(tmp_path / "p.npz", young_kPa=young))
        assert np.unique(problem.material.young_array).tolist() == [10.0]


def test_prescribed_displacements_follow_their_nodes(tmp_path):
    fixed = problem_arrays()["fixed_nodes"][::-1]
    given = np.stack([fixed, 0 * fixed, 0 * fixed], axis=1).astype(float)
    problem = read_problem(write_problem(tmp_path / "p.npz", fixed_nodes=fixed, prescribed_mm=given, forces_mN=None))
    assert np.array_equal(problem.load.prescribed[:, 0], problem.mesh.fixed_nodes)
    assert problem.load.forces is None


def test_a_solution_is_a_simulation(tmp_path):
    problem = read_problem(write_problem(tmp_path / "p.npz"))
    field = np.linspace(0, 1, problem.mesh.nodes.size).reshape(-1, 3)
    write_solution(tmp_path / "u.npz", problem, field, np.zeros((len(problem.mesh.fixed_nodes), 3)))
    assert np.array_equal(read_simulation(tmp_path / "u.npz", problem.mesh.n_nodes), field)


BAD = {
    "array missing": ({"forces_mN": None}, FormatError, "'forces_mN'; it holds: nodes_mm"),
    "tets missing": ({"tets": None}, FormatError, "an array 'tets'"),
    "fixed missing": ({"fixed_nodes": None}, FormatError, "an array 'fixed_nodes'"),
    "forces misshapen": (
        {"forces_mN": np.zeros((3, 3))},
        FormatError,
        r"`forces_mN` must have shape \(120, 3\)",
    ),
    "forces not finite": ({"forces_mN": np.full((120, 3), np.nan)}, FormatError, r"finite, got nan at \[0, 0\]"),
    "planar nodes": ({"nodes_mm": np.zeros((120, 2))}, FormatError, r"`nodes_mm` must have shape \(any, 3\)"),
    "nodes not finite": (
        {"nodes_mm": np.full((120, 3), np.inf)},
        MeshError,
        r"p\.npz: node coordinates must be finite",
    ),
    "tets as floats": ({"tets": np.zeros((4, 4))}, FormatError, "`tets` must hold integers"),
    "text": ({"young_kPa": "soft"}, FormatError, "'young_kPa' in .* must hold real numbers"),
    "complex": ({"young_kPa": 10.0 + 1j}, FormatError, "'young_kPa' in .* must hold real numbers"),
    "pickled": ({"young_kPa": np.array([None, {}], dtype=object)}, FormatError, "'young_kPa' .* pickled objects"),
    "moduli of another count": ({"young_kPa": np.ones(7)}, FormatError, r"`young_kPa` must have shape \(360,\)"),
    "nothing held": ({"fixed_nodes": np.array([], int)}, MeshError, "'fixed' must hold at least one node"),
    "held node out of range": ({"fixed_nodes": np.array([999])}, MeshError, "nodes 0 to 119, got 999"),
    "nu at one half": ({"poisson": 0.5}, MaterialError, r"p\.npz: `poisson` must be in \(-1, 0.5\), got 0.5"),
    "negative modulus": ({"young_kPa": -1.0}, MaterialError, "`young` must be positive, in kPa, got -1"),
    "repeated held node": (
        {"fixed_nodes": np.array([0, 0]), "prescribed_mm": np.zeros((2, 3))},
        FormatError,
        "must not repeat a node",
    ),
}


@pytest.mark.parametrize(("changes", "error", "words"), BAD.values(), ids=BAD)
def test_a_faulty_problem_is_refused_by_array(tmp_path, changes, error, words):
    path = write_problem(tmp_path / "p.npz", **changes)
    with pytest.raises(error, match=words):
        read_problem(path)


def test_a_cut_archive_is_refused(tmp_path):
    path = write_problem(tmp_path / "p.npz")
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:size])
        with pytest.raises(FormatError, match=r"p\.npz must be a numpy archive"):
            read_problem(path)


def test_a_spoilt_member_is_refused_by_name(tmp_path):
    path = write_problem(tmp_path / "p.npz")
    whole = bytearray(path.read_bytes())
    at = whole.index(b"nodes_mm.npy") + 400
    whole[at : at + 8] = b"\xff" * 8
    path.write_bytes(bytes(whole))
    with pytest.raises(FormatError, match=r"array 'nodes_mm' in .*p\.npz"):
        read_problem(path)


def test_a_single_array_or_a_pickle_is_no_archive(tmp_path):
    np.save(tmp_path / "p.npy", np.zeros(3))
    (tmp_path / "p.npy").rename(tmp_path / "p.npz")
    with pytest.raises(FormatError, match="single array"):
        read_problem(tmp_path / "p.npz")
    np.save(tmp_path / "q.npy", np.array([{}], dtype=object))
    (tmp_path / "q.npy").rename(tmp_path / "q.npz")
    with pytest.raises(FormatError, match="pickled objects are never loaded"):
        read_problem(tmp_path / "q.npz")


def test_a_field_of_another_mesh_is_refused(tmp_path):
    np.savez(tmp_path / "u.npz", displacement_mm=np.zeros((5, 3)))
    with pytest.raises(FormatError, match=r"`displacement_mm` must have shape \(7, 3\), got \(5, 3\)"):
        read_simulation(tmp_path / "u.npz", 7)
