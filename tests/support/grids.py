"""Mesh files as other programs write them, from short writers of the tests' own."""

import base64
import lzma
import zlib
from pathlib import Path

import numpy as np

#: VTK's and Gmsh's numbers of kinds of cells, and their dimensions.
VTK = {"line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "tetra10": 24}
GMSH = {"line": 1, "triangle": 2, "quad": 3, "tetra": 4, "hexahedron": 5, "tetra10": 11}
DIMENSION = {"line": 1, "triangle": 2, "quad": 2, "tetra": 3, "hexahedron": 3, "tetra10": 3}


def write_grid(path: Path, nodes, cells, point_data=None, **how) -> Path:
    """Write nodes (n, 3), cells as (kind, rows) pairs and point data as .vtu, .vtk or .msh, by the path's ending."""
    write = {".vtu": write_vtu_text, ".vtk": write_vtk, ".msh": write_msh}[path.suffix]
    write(path, np.asarray(nodes, float), [(kind, np.asarray(rows)) for kind, rows in cells], point_data or {}, **how)
    return path


def piece(nodes, cells, point_data):
    """Return one piece of a .vtu."""
    ends = np.cumsum([rows.shape[1] for _, rows in cells for _ in rows])
    joined = np.concatenate([rows.ravel() for _, rows in cells])
    types = [VTK[kind] for kind, rows in cells for _ in rows]
    data = "".join(array(name, values) for name, values in point_data.items())
    return (
        f'<Piece NumberOfPoints="{len(nodes)}" NumberOfCells="{len(types)}"><PointData>{data}</PointData>'
        f"<Points>{array('Points', nodes)}</Points><Cells>{array('connectivity', joined)}{array('offsets', ends)}"
        f"{array('types', np.array(types, np.uint8))}</Cells></Piece>"
    )


def array(name, values, more=""):
    """Return an array of a .vtu as text."""
    values = np.asarray(values)
    kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind] + str(8 * values.dtype.itemsize)
    width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    text = " ".join(map(str, values.ravel().tolist()))
    return f'<DataArray type="{kind}" Name="{name}"{width} format="ascii"{more}>{text}</DataArray>'


def write_vtu_text(path, nodes, cells, point_data, head=""):
    write_pieces(path, [piece(nodes, cells, point_data)], head)


def write_pieces(path, pieces, head=""):
    """Write a .vtu of some pieces; `head` stands before them."""
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">'
        f"<UnstructuredGrid>{head}{''.join(pieces)}</UnstructuredGrid></VTKFile>\n"
    )
    return path


def write_vtk(path, nodes, cells, point_data, binary=False, title="a mesh"):
    rows = [row for _, block in cells for row in block]
    flat = np.concatenate([np.concatenate([[len(row)], row]) for row in rows])
    types = np.array([VTK[kind] for kind, block in cells for _ in block])

    def numbers(values, kind):
        values = np.asarray(values)
        return values.astype(kind).tobytes() if binary else " ".join(map(str, values.ravel().tolist())).encode()

    parts = [
        f"# vtk DataFile Version 3.0\n{title}\n{'BINARY' if binary else 'ASCII'}\nDATASET UNSTRUCTURED_GRID\n".encode()
    ]
    parts += [f"POINTS {len(nodes)} double\n".encode(), numbers(nodes, ">f8")]
    parts += [f"\nCELLS {len(rows)} {len(flat)}\n".encode(), numbers(flat, ">i4")]
    parts += [f"\nCELL_TYPES {len(rows)}\n".encode(), numbers(types, ">i4")]
    parts += [f"\nPOINT_DATA {len(nodes)}\n".encode()] if point_data else []
    for name, values in point_data.items():
        values = np.asarray(values)
        if values.ndim == 2:
            parts += [f"VECTORS {name} double\n".encode(), numbers(values, ">f8"), b"\n"]
        else:
            kind, code = ("double", ">f8") if values.dtype.kind == "f" else ("int", ">i4")
            parts += [f"SCALARS {name} {kind} 1\nLOOKUP_TABLE default\n".encode(), numbers(values, code), b"\n"]
    path.write_bytes(b"".join(parts))


def write_msh(path, nodes, cells, point_data, version="2.2", binary=False, groups=(), names="", order="<"):
    """Write a .msh: `groups` are the physical groups of each block of cells, 0 for none; `names` its $PhysicalNames."""
    groups = list(groups) or [0] * len(cells)
    out = _Out(binary, order)
    out.text(f"$MeshFormat\n{version} {int(binary)} 8\n")
    if binary:
        out.numbers("i4", [1])
    out.text("$EndMeshFormat\n")
    if names:
        out.text(f"$PhysicalNames\n{names}\n$EndPhysicalNames\n")
    (_msh_2 if version.startswith("2") else _msh_4)(out, nodes, cells, groups)
    for name, values in point_data.items():
        values = np.asarray(values, float).reshape(len(nodes), -1)
        out.text(f'$NodeData\n1\n"{name}"\n1\n0.0\n3\n0\n{values.shape[1]}\n{len(nodes)}\n')
        for tag, row in enumerate(values, 1):
            out.numbers("i4", [tag], "f8", row)
        out.text("$EndNodeData\n")
    path.write_bytes(b"".join(out.parts))


class _Out:
    def __init__(self, binary, order):
        self.binary, self.order, self.parts = binary, order, []

    def text(self, text):
        self.parts.append(text.encode())

    def numbers(self, *pairs):
        for kind, values in zip(pairs[::2], pairs[1::2], strict=True):
            numbers = np.asarray(values, kind)
            plain = " ".join(map(repr, numbers.tolist())).encode() + b" "
            self.parts.append(numbers.astype(self.order + kind).tobytes() if self.binary else plain)
        self.parts.append(b"" if self.binary else b"\n")


def _msh_2(out, nodes, cells, groups):
    out.text(f"$Nodes\n{len(nodes)}\n")
    for tag, place in enumerate(nodes, 1):
        out.numbers("i4", [tag], "f8", place)
    out.text(f"$EndNodes\n$Elements\n{sum(len(rows) for _, rows in cells)}\n")
    tag = 0
    for (kind, rows), group in zip(cells, groups, strict=True):
        for row in rows + 1:
            tag += 1
            head = [GMSH[kind], 1, 2, tag] if out.binary else [tag, GMSH[kind], 2]
            out.numbers("i4", [*head, group, 1, *row])
    out.text("$EndElements\n")


def _msh_4(out, nodes, cells, groups):
    out.text("$Entities\n")
    of_dimension = [[i for i, (kind, _) in enumerate(cells) if DIMENSION[kind] == d] for d in range(4)]
    out.numbers("u8", [len(each) for each in of_dimension])
    for entity in (i for each in of_dimension for i in each):
        tags = [groups[entity]] if groups[entity] else []
        out.numbers("i4", [entity + 1], "f8", [0.0] * 6, "u8", [len(tags)], "i4", tags, "u8", [0], "i4", [])
    out.text("$EndEntities\n$Nodes\n")
    out.numbers("u8", [1, len(nodes), 1, len(nodes)])
    out.numbers("i4", [3, 1, 0], "u8", [len(nodes)])
    out.numbers("u8", np.arange(1, len(nodes) + 1))
    for place in nodes:
        out.numbers("f8", place)
    out.text("$EndNodes\n$Elements\n")
    total = sum(len(rows) for _, rows in cells)
    out.numbers("u8", [len(cells), total, 1, total])
    tag = 1
    for entity, (kind, rows) in enumerate(cells, 1):
        out.numbers("i4", [DIMENSION[kind], entity, GMSH[kind]], "u8", [len(rows)])
        for row in rows + 1:
            out.numbers("u8", [tag, *row])
            tag += 1
    out.text("$EndElements\n")


def write_modern_vtk(path, nodes, tets, title="vtk output", field="SPACE 1 1 string\nRAS\n"):
    """Write tets as VTK 9 does: version 5.1 with offsets, ids of 64 bits, field data of texts, blocks of metadata."""
    text = [f"# vtk DataFile Version 5.1\n{title}\nASCII\nDATASET UNSTRUCTURED_GRID\nFIELD FieldData 1\n{field}"]
    text += [
        "METADATA\nINFORMATION 0\n\n",
        f"POINTS {len(nodes)} double\n",
        _rows(nodes),
        "METADATA\nINFORMATION 0\n\n",
    ]
    text += [f"CELLS {len(tets) + 1} {tets.size}\nOFFSETS vtktypeint64\n", _rows(4 * np.arange(len(tets) + 1))]
    text += ["CONNECTIVITY vtktypeint64\n", _rows(tets), f"CELL_TYPES {len(tets)}\n", _rows(np.full(len(tets), 10))]
    text += [f"\nPOINT_DATA {len(nodes)}\nFIELD FieldData 2\nlow%20end 1 {len(nodes)} unsigned_char\n"]
    text += [_rows((nodes[:, 2] == 0).astype(int)), "METADATA\nINFORMATION 0\n\n"]
    text += [f"fixed 1 {len(nodes)} long\n", _rows((nodes[:, 2] == 0).astype(int))]
    path.write_text("".join(text))
    return path


def _rows(values):
    return "".join(" ".join(map(str, row)) + " \n" for row in np.asarray(values).reshape(-1, 1).tolist())


def write_appended_vtu(path, nodes, tets, packed="", raw=True, order="<", header="u4"):
    """Write tets as arrays that are appended, packed in blocks of 1 KB by zlib, lzma or lz4, or not at all."""
    arrays = {
        "Points": (np.asarray(nodes), "Float64", 3),
        "connectivity": (np.asarray(tets, np.int32), "Int32", 1),
        "offsets": (4 * np.arange(1, len(tets) + 1, dtype=np.int32), "Int32", 1),
        "types": (np.full(len(tets), 10, np.uint8), "UInt8", 1),
        "fixed": ((nodes[:, 2] == 0).astype(np.int16), "Int16", 1),
    }
    written, data = {}, b""
    for name, (values, kind, width) in arrays.items():
        content = values.astype(values.dtype.newbyteorder(order)).tobytes()
        stream = _stream(content, packed, np.dtype(order + header), raw)
        shape = f'type="{kind}" Name="{name}" NumberOfComponents="{width}"'
        written[name] = f'<DataArray {shape} format="appended" offset="{len(data)}"/>'
        data += stream
    name = {"zlib": "ZLib", "lzma": "LZMA", "lz4": "LZ4"}.get(packed)
    head = (
        f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{"Little" if order == "<" else "Big"}Endian" '
        f'header_type="UInt{8 * np.dtype(header).itemsize}"'
        + (f' compressor="vtk{name}DataCompressor"' if name else "")
    )
    path.write_bytes(
        f'{head}><UnstructuredGrid><Piece NumberOfPoints="{len(nodes)}" NumberOfCells="{len(tets)}"><PointData>'
        f"{written['fixed']}</PointData><Points>{written['Points']}</Points><Cells>{written['connectivity']}"
        f"{written['offsets']}{written['types']}</Cells></Piece></UnstructuredGrid>"
        f'<AppendedData encoding="{"raw" if raw else "base64"}">\n_'.encode()
        + data
        + b"\n</AppendedData></VTKFile>\n"
    )
    return path


def _stream(content, packed, header, raw):
    if not packed:
        sizes, body = np.array([len(content)], header).tobytes(), content
        return sizes + body if raw else base64.b64encode(sizes + body)
    pack = {"zlib": zlib.compress, "lzma": lzma.compress, "lz4": lz4_block}[packed]
    blocks = [pack(content[at : at + 1024]) for at in range(0, len(content), 1024)]
    sizes = np.array([len(blocks), 1024, len(content) % 1024, *map(len, blocks)], header).tobytes()
    body = b"".join(blocks)
    return sizes + body if raw else base64.b64encode(sizes) + base64.b64encode(body)


def lz4_block(content):
    """Pack bytes as one LZ4 block, with the last place at which four bytes stood before as the only candidate."""
    out, seen, begin, at = bytearray(), {}, 0, 0

    def more(length):
        return b"\xff" * (length // 255) + bytes([length % 255])

    def sequence(literals, match):
        token = min(len(literals), 15) << 4 | min(max(match - 4, 0), 15)
        return bytes([token]) + (more(len(literals) - 15) if len(literals) >= 15 else b"") + literals

    while at + 12 < len(content):
        back = at - seen.get(content[at : at + 4], at)
        seen[content[at : at + 4]] = at
        if not 0 < back < 65536:
            at += 1
            continue
        length = 4
        while at + length < len(content) - 5 and content[at + length] == content[at + length - back]:
            length += 1
        out += sequence(content[begin:at], length) + back.to_bytes(2, "little")
        out += more(length - 19) if length >= 19 else b""
        at += length
        begin = at
    return bytes(out + sequence(content[begin:], 0))


def write_xdmf(path, nodes, cells, tags, name="facet_tags"):
    """Write cells as dolfinx does: a mesh, and tags of the first block's cells, with arrays in an HDF5 file."""
    import h5py

    kinds = {"triangle": "Triangle", "tetra": "Tetrahedron", "tetra10": "Tetrahedron_10"}
    beside = path.with_suffix(".h5")
    with h5py.File(beside, "w") as file:
        file["Mesh/mesh/geometry"] = nodes
        file["Mesh/mesh/topology"] = cells[1][1]
        file[f"MeshTags/{name}/topology"] = cells[0][1]
        file[f"MeshTags/{name}/Values"] = np.asarray(tags).reshape(-1, 1)

    def item(place, shape, kind):
        return f'<DataItem Dimensions="{shape}" NumberType="{kind}" Format="HDF">{beside.name}:{place}</DataItem>'

    def topology(place, kind, rows):
        inside = item(place, f"{len(rows)} {rows.shape[1]}", "Int")
        return f'<Topology TopologyType="{kinds[kind]}" NumberOfElements="{len(rows)}">{inside}</Topology>'

    (flat, faces), (solid, tets) = cells
    path.write_text(
        '<?xml version="1.0"?>\n<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>\n'
        '<Xdmf Version="3.0" xmlns:xi="https://www.w3.org/2001/XInclude">\n<Domain>\n'
        f'<Grid Name="mesh" GridType="Uniform">{topology("/Mesh/mesh/topology", solid, tets)}'
        f'<Geometry GeometryType="XYZ">{item("/Mesh/mesh/geometry", f"{len(nodes)} 3", "Float")}</Geometry></Grid>\n'
        f'<Grid Name="{name}" GridType="Uniform"><xi:include xpointer="xpointer(/Xdmf/Domain/Grid/Geometry)"/>'
        f"{topology(f'/MeshTags/{name}/topology', flat, faces)}"
        f'<Attribute Name="{name}" AttributeType="Scalar" Center="Cell">'
        f"{item(f'/MeshTags/{name}/Values', f'{len(faces)} 1', 'Int')}</Attribute></Grid>\n</Domain></Xdmf>\n"
    )
    return path
