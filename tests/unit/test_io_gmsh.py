"""Gmsh's files, text and binary, with groups on some entities only."""

import numpy as np
import pytest

import tissuereg as tr
from support.grids import write_grid
from support.meshes import block
from tissuereg.errors import FormatError
from tissuereg.io.fields import read_displacement

MESH = block(cells=(2, 1, 2))
BASE = MESH.surface[(MESH.nodes[MESH.surface][:, :, 2] == 0).all(axis=1)]
EDGE = np.array([[0, 3], [3, 6]])
CELLS = [("line", EDGE), ("triangle", BASE), ("tetra", MESH.tets)]
FORMS = pytest.mark.parametrize(
    "how",
    [
        {"version": version, "binary": binary, "order": order}
        for version in ("2.2", "4.1")
        for binary, order in ((False, "<"), (True, "<"), (True, ">"))
    ],
    ids=lambda how: f"{how['version']}-{'binary' if how['binary'] else 'text'}-{how['order']}",
)


@FORMS
def test_groups_on_some_entities_only_are_node_sets(tmp_path, how):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS, groups=(0, 7, 0), names='1\n2 7 "fixed"', **how)
    mesh = tr.read_mesh(path)
    assert mesh.digest() == MESH.digest()
    assert list(mesh.node_sets) == ["fixed"]


@FORMS
def test_groups_without_a_name_are_called_by_dimension_and_number(tmp_path, how):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS, groups=(7, 7, 2), **how)
    found = {name: nodes.tolist() for name, nodes in tr.read_mesh(path, fixed="surface_7").node_sets.items()}
    assert sorted(found) == ["curve_7", "fixed", "surface_7", "volume_2"]
    assert found["curve_7"] == np.unique(EDGE).tolist()
    assert found["fixed"] == np.unique(BASE).tolist()


@FORMS
def test_values_at_nodes_are_a_displacement(tmp_path, how):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS, {"displacement": 0.1 * MESH.nodes}, **how)
    assert np.allclose(read_displacement(path, MESH), 0.1 * MESH.nodes)


def test_elements_that_stand_once_for_each_of_their_groups_are_read_once(tmp_path):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, [*CELLS, ("tetra", MESH.tets[:5])], groups=(0, 7, 1, 2))
    mesh = tr.read_mesh(path)
    assert mesh.n_tets == MESH.n_tets
    assert mesh.node_set("volume_2").tolist() == np.unique(MESH.tets[:5]).tolist()


def test_nodes_may_have_any_numbers_in_any_order(tmp_path):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS)
    lines = path.read_text().splitlines()
    begin, end = lines.index("$Nodes") + 2, lines.index("$EndNodes")
    named = {str(old): str(1000 - 7 * old) for old in range(1, MESH.n_nodes + 1)}
    nodes = [" ".join([named[line.split()[0]], *line.split()[1:]]) for line in lines[begin:end]]
    first, last = lines.index("$Elements") + 2, lines.index("$EndElements")
    elements = [line.split() for line in lines[first:last]]
    elements = [" ".join([*words[:5], *(named[word] for word in words[5:])]) for words in elements]
    path.write_text("\n".join([*lines[:begin], *nodes[::-1], *lines[end:first], *elements, *lines[last:]]) + "\n")
    mesh = tr.read_mesh(path)
    assert np.array_equal(mesh.nodes[mesh.tets], MESH.nodes[MESH.tets])


def test_comments_state_the_frame_and_unknown_sections_are_passed_over(tmp_path):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS)
    more = "$Comments\nSPACE=LPS units: cm\n$EndComments\n$Periodic\n0\n$EndPeriodic\n"
    path.write_text(path.read_text().replace("$Nodes", more + "$Nodes", 1))
    mesh = tr.read_mesh(path)
    assert mesh.frame == "LPS"
    assert np.allclose(mesh.nodes, 10.0 * MESH.nodes)


def test_groups_of_a_mesh_that_was_cut_into_parts_are_kept(tmp_path):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS, groups=(0, 7, 0), version="4.1")
    # A part of the surface is an entity of its own, with the group of the surface that it is a part of.
    head, (word, section) = path.read_text(), ("$PartitionedEntities", "2\n1\n9 1\n0 0 1 0\n")
    begin = head.index("$Entities")
    rows = head[begin : head.index("$EndEntities")].splitlines()
    surface = next(row for row in rows[2:] if row.split()[7:9] == ["1", "7"])
    tag, *rest = surface.split()
    more = f"{word}\n{section}{tag} 2 99 2 1 2 {' '.join(rest)}\n$EndPartitionedEntities\n"
    path.write_text(head.replace(surface, " ".join([tag, *rest[:6], "0", "0"])).replace("$Nodes", more + "$Nodes", 1))
    assert tr.read_mesh(path, fixed="surface_7").fixed_nodes.tolist() == np.unique(BASE).tolist()


@pytest.mark.parametrize("spoil", [lambda text: b"\xef\xbb\xbf" + text, lambda text: text.replace(b"\n", b"\r")])
def test_a_mark_at_the_beginning_and_other_ends_of_lines_do_not_matter(tmp_path, spoil):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS)
    path.write_bytes(spoil(path.read_bytes()))
    assert tr.read_mesh(path).n_tets == MESH.n_tets


@pytest.mark.parametrize(
    ("version", "old", "new", "words"),
    [
        ("2.2", "$Nodes\n18", "$Nodes\n19", "numbers must stand, got "),
        ("2.2", "$Nodes\n18", "$Nodes\n99999999999999", "more numbers must follow"),
        ("2.2", " 4 2 0 1 ", " 4 99999 0 1 ", "each whole; one of type 4 with 99999 tags is not"),
        ("2.2", " 4 2 0 1 ", " 77 2 0 1 ", "of a type that is read .*, got type 77"),
        ("4.1", "$Elements\n3 ", "$Elements\n9999999999 ", "more numbers must follow|numbers must follow"),
        ("4.1", "4.1 0 8", "4 0 8", "version 2 to 2.2 or 4.1, got '4 0 8': save it as one of these"),
        ("4.1", "$EndNodes", "$EndKnots", r"must end with \$EndNodes"),
    ],
)
def test_what_a_file_does_not_hold_is_said(tmp_path, version, old, new, words):
    path = write_grid(tmp_path / "b.msh", MESH.nodes, CELLS, version=version)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FormatError, match=rf"b\.msh must be a mesh .*({words})"):
        tr.read_mesh(path)
