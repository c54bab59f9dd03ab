"""Writing of tetrahedra with values at their nodes as VTK's XML (``.vtu``): base64 in place, packed by zlib."""

import base64
import zlib
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.io.vtk_cells import TETRA

_BLOCK = 1 << 15
_TYPES = {"f": "Float", "i": "Int", "u": "UInt"}


def vtu_bytes(
    points: FloatArray,
    tets: IntArray,
    point_data: Mapping[str, npt.NDArray[Any]],
    texts: Mapping[str, str],
    flags: tuple[str, ...] = (),
) -> bytes:
    """Return a .vtu file as bytes.

    `points` (n, 3) in mm; `tets` (m, 4); `point_data`: numbers with one row a point; `texts`: field data that hold a
    text, by name; `flags`: names of field data that hold a single 1.
    """
    ends = 4 * np.arange(1, len(tets) + 1, dtype=np.int64)
    types = np.full(len(tets), TETRA, np.uint8)
    cells: dict[str, npt.NDArray[Any]] = {
        "connectivity": np.asarray(tets, np.int64).ravel(),
        "offsets": ends,
        "types": types,
    }
    one = '<DataArray type="Int8" Name={} NumberOfTuples="1" format="ascii">1</DataArray>'
    fields = [one.format(quoteattr(name)) for name in flags]
    fields += [_text(name, text) for name, text in texts.items()]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt32" '
        'compressor="vtkZLibDataCompressor">',
        "<UnstructuredGrid>",
        *(["<FieldData>", *fields, "</FieldData>"] if fields else []),
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(tets)}">',
        "<Points>",
        _array("Points", points),
        "</Points>",
        "<Cells>",
        *(_array(name, array) for name, array in cells.items()),
        "</Cells>",
        "<PointData>",
        *(_array(name, array) for name, array in point_data.items()),
        "</PointData>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    return "\n".join(lines).encode("utf-8")


def _array(name: str, array: npt.NDArray[Any]) -> str:
    kind = f"{_TYPES[array.dtype.kind]}{8 * array.dtype.itemsize}"
    width = f' NumberOfComponents="{array.shape[1]}"' if array.ndim == 2 else ""
    content = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
    return f'<DataArray type="{kind}" Name={quoteattr(name)}{width} format="binary">\n{_packed(content)}\n</DataArray>'


def _text(name: str, text: str) -> str:
    content = _packed(text.encode("utf-8") + b"\0")
    return f'<Array type="String" Name={quoteattr(name)} NumberOfTuples="1" format="binary">\n{content}\n</Array>'


def _packed(content: bytes) -> str:
    """Return bytes as base64 of the sizes of their packed blocks, and of the blocks."""
    parts = [zlib.compress(content[at : at + _BLOCK]) for at in range(0, len(content), _BLOCK)]
    sizes = np.array([len(parts), _BLOCK, len(content) % _BLOCK, *map(len, parts)], "<u4")
    return (base64.b64encode(sizes.tobytes()) + base64.b64encode(b"".join(parts))).decode("ascii")
