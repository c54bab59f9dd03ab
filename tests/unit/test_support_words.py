"""Supports that hold everything are refused; those that hold nothing, or not what a mesh suggests, are warned of."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import run
from support.meshes import block
from tissuereg.errors import MeshError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers


@pytest.fixture(scope="module")
def bare():
    mesh = block(cells=(3, 2, 4))
    return tr.Mesh(mesh.nodes, mesh.tets)


def markers_on(mesh):
    top = mesh.nodes[mesh.nodes[:, 2] == 40.0]
    return tr.Markers(top, top + np.array([0.3, 0.0, 0.0]))


@pytest.mark.parametrize("held", ["sure", "perhaps"])
@pytest.mark.parametrize("nodes", ["all", "surface"])
def test_a_body_held_all_over_is_refused(bare, held, nodes):
    mesh = bare.with_node_set("fixed", np.arange(bare.n_nodes) if nodes == "all" else bare.surface_nodes)
    with pytest.raises(MeshError, match="every boundary triangle is held"):
        tr.Body(mesh, held=held)
    assert tr.Body(mesh, held="free").supports.moves


def test_all_nodes_given_by_number_are_refused_and_all_but_one_are_not(bare):
    with pytest.raises(MeshError, match="every boundary triangle is held"):
        tr.Body(bare, held_nodes=bare.surface_nodes)
    assert tr.Body(bare, held_nodes=bare.surface_nodes[1:]).supports.holds


def test_the_command_refuses_a_body_held_all_over(bare, tmp_path, capsys):
    write_vtu(tmp_path / "body.vtu", bare)
    write_markers(tmp_path / "markers.csv", markers_on(bare))
    given = ("register", tmp_path / "body.vtu", tmp_path / "markers.csv", "--out", tmp_path / "out")
    code, _, err = run(capsys, *given, "--fixed", "plane 0 0 1 0 100")
    assert code == 2
    assert "held" in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_body_that_nothing_holds_is_warned_of_unless_it_is_said_to_be_free(bare):
    with pytest.warns(UserWarning, match=r"since no node is held: .* \(it has: none\); .* held='free'"):
        tr.Registrar(bare, markers_on(bare))
    tr.Registrar(tr.Body(bare, held="free"), markers_on(bare))


@pytest.mark.parametrize("name", ["Fixed", "FIXED", " fixed"])
def test_a_set_named_like_fixed_holds_nothing_and_is_not_ignored_in_silence(bare, name):
    base = np.flatnonzero(bare.nodes[:, 2] == 0.0)
    likely = bare.with_node_set(name, base)
    with pytest.warns(UserWarning, match="held") as said:
        assert tr.Registrar(likely, markers_on(bare)).attached.body.supports.moves
    words = [str(one.message) for one in said]
    assert words[0].startswith(f"the nodes of the set {name!r} are not held")
    assert "since no node is held" in words[1]
    with pytest.warns(UserWarning, match="are not held"):
        tr.Registrar(likely.with_node_set("fixed", base[:6]), markers_on(bare))
    tr.Registrar(likely.with_node_set("fixed", base), markers_on(bare))


def test_a_held_set_that_is_free_is_no_set_at_all(shared_data):
    cases = shared_data / "cases"
    markers, targets = tr.read_markers(cases / "held-free" / "shift20.csv"), tr.read_targets(cases / "targets.csv")
    mesh = tr.read_mesh(cases / "held-free" / "with_fixed.vtu")
    with_set, without = (
        tr.register(tr.Body(one, held="free"), markers, targets=targets)
        for one in (mesh, tr.Mesh(mesh.nodes, mesh.tets))
    )
    assert with_set.trust.ok, with_set.trust.reasons
    assert with_set.markers.dropped == ()
    np.testing.assert_array_equal(with_set.displacement, without.displacement)
    for name, place in {"lesion": (21.71, 2.23, 35.90), "vessel": (-12.98, -7.41, 33.48)}.items():
        assert np.linalg.norm(with_set.target(name).mean - place) < 2.0
