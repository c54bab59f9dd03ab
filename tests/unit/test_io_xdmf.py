"""XDMF with HDF5, as FEniCS writes it."""

import os

import h5py
import numpy as np
import pytest

import tissuereg as tr
from support.grids import write_xdmf
from support.meshes import block
from tissuereg.errors import FormatError
from tissuereg.io.fields import read_displacement
from tissuereg.io.surfaces import read_triangles

MESH = block(cells=(2, 1, 2))
CELLS = [("triangle", MESH.surface), ("tetra", MESH.tets)]
BELOW = (MESH.nodes[MESH.surface][:, :, 2] == 0).all(axis=1)


@pytest.mark.parametrize(("tags", "name"), [(BELOW * 6 + 1, "facet_tags_7"), (BELOW.astype(float), "facet_tags")])
def test_tags_of_facets_are_node_sets(tmp_path, tags, name):
    mesh = tr.read_mesh(write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, tags), fixed=name)
    assert mesh.digest() == MESH.digest()


def test_a_field_at_the_nodes_is_a_displacement(tmp_path):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, BELOW)
    with h5py.File(tmp_path / "b.h5", "a") as file:
        file["Function/u/0"] = 0.1 * MESH.nodes
    field = (
        '<Attribute Name="u" AttributeType="Vector" Center="Node"><DataItem Dimensions="18 3" Format="HDF">'
        "b.h5:/Function/u/0</DataItem></Attribute></Grid>"
    )
    path.write_text(path.read_text().replace("</Grid>", field, 1))
    assert np.allclose(read_displacement(path, MESH, "u"), 0.1 * MESH.nodes)


def test_arrays_in_the_text_mixed_cells_and_a_mesh_that_stands_twice(tmp_path):
    mixed = np.hstack([np.full((MESH.n_tets, 1), 6), MESH.tets]).ravel().tolist()
    grid = (
        '<Grid Name="mesh"><Topology TopologyType="Mixed" NumberOfElements="24"><DataItem NumberType="Int" '
        f'Dimensions="{len(mixed)}">{" ".join(map(str, mixed))}</DataItem></Topology><Geometry GeometryType="XYZ">'
        f'<DataItem Dimensions="18 3">{" ".join(map(str, MESH.nodes.ravel()))}</DataItem></Geometry></Grid>'
    )
    (tmp_path / "b.xdmf").write_text(f"<Xdmf><Domain>{grid}{grid}</Domain></Xdmf>")
    mesh = tr.read_mesh(tmp_path / "b.xdmf")
    assert np.array_equal(mesh.tets, MESH.tets)
    assert np.array_equal(mesh.nodes, MESH.nodes)


def test_a_surface_alone_is_one(tmp_path):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, [CELLS[0], ("triangle", MESH.surface)], BELOW)
    assert read_triangles(path).volume == pytest.approx(24000.0)
    with pytest.raises(FormatError, match="holds triangle only"):
        tr.read_mesh(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("b.h5:/Mesh/mesh/geometry", "c.h5:/Mesh/mesh/geometry", "no such file: .*c.h5"),
        ("b.h5:/Mesh/mesh/geometry", "b.h5:/Mesh/mesh/places", "must hold numbers at '/Mesh/mesh/places'"),
        ("Tetrahedron", "Dodecahedron", "of a type that is read .*, got 'dodecahedron'"),
        ('Format="HDF"', 'Format="Binary"', "in the text \\(XML\\) or in HDF5 \\(HDF\\), got 'BINARY'"),
        ('GeometryType="XYZ"', 'GeometryType="VXVYVZ"', "of the type XYZ or XY, got VXVYVZ"),
        (
            "<DataItem ",
            '<DataItem ItemType="HyperSlab" ',
            "got one by reference, or of the type HyperSlab",
        ),
        ("<DataItem ", '<DataItem Reference="XML" ', "as they are; got one by reference"),
        ("<Topology ", '<Topology BaseOffset="-1" ', "counted from a whole number.*BaseOffset is -1"),
    ],
)
def test_what_is_not_there_is_said(tmp_path, old, new, words):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, BELOW)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FormatError, match=words):
        tr.read_mesh(path)


def test_a_size_that_the_file_claims_takes_no_memory(tmp_path):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, BELOW)
    with h5py.File(tmp_path / "b.h5", "a") as file:
        del file["Mesh/mesh/geometry"]
        file.create_dataset("Mesh/mesh/geometry", (40_000_000, 3), "f8", chunks=(1000, 3))
    with pytest.raises(FormatError, match="most of its 960 MB are not"):
        tr.read_mesh(path)


def test_points_may_be_counted_from_another_number(tmp_path):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, BELOW)
    with h5py.File(tmp_path / "b.h5", "a") as file:
        for name in ("Mesh/mesh/topology", "MeshTags/facet_tags/topology"):
            file[name][...] += 3
    path.write_text(path.read_text().replace("<Topology ", '<Topology BaseOffset="3" '))
    assert np.array_equal(tr.read_mesh(path).tets, MESH.tets)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize("kind", ["link", "raw", "virtual", "soft"])
def test_an_array_that_lies_in_another_file_is_refused_and_not_waited_for(tmp_path, kind):
    path = write_xdmf(tmp_path / "b.xdmf", MESH.nodes, CELLS, BELOW)
    os.mkfifo(tmp_path / "pipe")
    with h5py.File(tmp_path / "b.h5", "a") as file:
        del file["Mesh/mesh/geometry"]
        if kind == "raw":
            file.create_dataset("Mesh/mesh/geometry", (18, 3), "f8", external=[(str(tmp_path / "pipe"), 0, 18 * 24)])
        elif kind == "virtual":
            layout = h5py.VirtualLayout((18, 3), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "pipe"), "x", (18, 3))
            file.create_virtual_dataset("Mesh/mesh/geometry", layout)
        else:
            target = h5py.SoftLink("/other") if kind == "soft" else h5py.ExternalLink(str(tmp_path / "pipe"), "/x")
            file["Mesh/mesh/geometry"] = target
    with pytest.raises(FormatError, match=r"must lie in b\.h5 itself"):
        tr.read_mesh(path)
