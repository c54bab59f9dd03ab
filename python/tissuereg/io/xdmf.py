"""XDMF (``.xdmf``) with arrays in HDF5 or in the text, as FEniCS writes it: a mesh, its tags, fields at its nodes.

Tags of cells become node sets: ``<name>_<tag>``, or ``<name>`` where they are 0 and 1.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, existing_file, too_large
from tissuereg.io.cursor import text_numbers
from tissuereg.io.grid import Block, Grid, checked_corners
from tissuereg.io.hdf5 import own_dataset
from tissuereg.io.notes import COMMENT

#: Kind of a topology and its points a cell (0: the file says it), by its name in lower case and its number if mixed.
_KINDS = {
    "polyvertex": ("vertex", 1, 1), "polyline": ("line", 2, 2), "triangle": ("triangle", 3, 4),
    "quadrilateral": ("quad", 4, 5), "tetrahedron": ("tetra", 4, 6), "pyramid": ("pyramid", 5, 7),
    "wedge": ("wedge", 6, 8), "hexahedron": ("hexahedron", 8, 9), "edge_3": ("line", 3, 34),
    "triangle_6": ("triangle", 6, 36), "quadrilateral_8": ("quad", 8, 37), "quadrilateral_9": ("quad", 9, 35),
    "tetrahedron_10": ("tetra", 10, 38), "tri_6": ("triangle", 6, 36), "tet_10": ("tetra", 10, 38),
    "hexahedron_20": ("hexahedron", 20, 48), "hexahedron_27": ("hexahedron", 27, 50),
}  # fmt: skip
_OF_NUMBER = {number: (kind, size) for kind, size, number in _KINDS.values()}
#: Types of mixed topologies whose number of points follows the type.
_SIZED = (1, 2)
#: Most tags of one name that become node sets: more are not tags but numbers of cells.
_MOST_TAGS = 200
#: Coordinates of a point by the type of a geometry.
_GEOMETRIES = {"XYZ": 3, "XY": 2}


def read_xdmf(file: Path) -> Grid:
    """Return the content of an .xdmf file: the first grid that has points, and all cells and tags on the same points.

    Raises `FormatError` if it or a file that it names is missing, holds no mesh, or is spoilt.
    """
    text = file.read_bytes()
    if b"<!ENTITY" in text:
        message = f"{file} must be an XDMF file, which declares no entities"
        raise FormatError(message)
    root = ElementTree.fromstring(text)
    grids = [grid for grid in root.iter("Grid") if grid.get("GridType", "Uniform") == "Uniform"]
    notes = [one.decode("utf-8", "replace") for one in COMMENT.findall(text)]
    notes += [f"{one.get('Name', '')}={one.get('Value') or one.text or ''}" for one in root.iter("Information")]
    with _Items(file) as items:
        grid = _together(items, grids)
    grid.notes = notes
    return grid


def _together(items: "_Items", grids: list[Any]) -> Grid:
    grid = Grid(_points(items, grids), [])
    last: tuple[list[Block], IntArray] | None = None
    for one in grids:
        topology = one.find("Topology")
        if topology is not None and topology.find("DataItem") is not None:
            last = _cells(items, topology, len(grid.points))
            grid.blocks += last[0]
        for attribute in one.findall("Attribute"):
            _attribute(items, attribute, grid, last)
    return grid


def _points(items: "_Items", grids: list[Any]) -> FloatArray:
    """Return the points (n, 3) that all grids share."""
    points: FloatArray | None = None
    for geometry in (found for grid in grids if (found := grid.find("Geometry")) is not None):
        kind = (geometry.get("GeometryType") or geometry.get("Type") or "XYZ").upper()
        if kind not in _GEOMETRIES:
            message = f"points must be of the type {' or '.join(_GEOMETRIES)}, got {kind[:40]}"
            raise FormatError(message)
        found = items.array(geometry.find("DataItem")).astype(np.float64).reshape(-1, _GEOMETRIES[kind])
        placed = np.column_stack([found, np.zeros((len(found), 3 - found.shape[1]))])
        if points is not None and not np.array_equal(placed, points):
            message = "all grids of an XDMF file must have the same points; two have not"
            raise FormatError(message)
        points = placed
    if points is None:
        message = "an XDMF file must hold a uniform grid with points; it holds none"
        raise FormatError(message)
    return points


def _cells(items: "_Items", topology: Any, n_points: int) -> tuple[list[Block], IntArray]:
    """Return cells as blocks, and for every cell in the order of the file (block, row), (n, 2)."""
    name = (topology.get("TopologyType") or topology.get("Type") or "").lower()
    values = np.ravel(items.array(topology.find("DataItem"))).astype(np.int64)
    first = topology.get("BaseOffset", "0").strip()
    if not first.isdecimal() or (name == "mixed" and int(first)):
        message = f"points must be counted from a whole number, in mixed cells from 0; BaseOffset is {first[:40]}"
        raise FormatError(message)
    values -= int(first[:18])
    if name == "mixed":
        return _mixed(values, n_points)
    if name not in _KINDS:
        message = f"a topology must be of a type that is read ({', '.join(_KINDS)}, mixed), got '{name[:40]}'"
        raise FormatError(message)
    kind, size, number = _KINDS[name]
    stated = topology.get("NodesPerElement", "")
    if number in _SIZED and stated.isdecimal() and 0 < int(stated) < 10:
        size = int(stated)
    rows = values.reshape(-1, size)
    return [checked_corners(kind, rows, n_points)], np.column_stack(
        [np.zeros(len(rows), np.int64), np.arange(len(rows))]
    )


def _mixed(values: IntArray, n_points: int) -> tuple[list[Block], IntArray]:
    rows: dict[tuple[str, int], list[list[int]]] = {}
    places, at, plain = [], 0, values.tolist()
    while at < len(plain):
        number = plain[at]
        kind, size = _OF_NUMBER.get(number, ("", 0))
        if number in _SIZED and at + 1 < len(plain):
            at, size = at + 1, plain[at + 1]
        at += 1
        if size < 1 or at + size > len(plain):
            message = f"mixed cells must be of a type that is read, and whole; type {number} is not"
            raise FormatError(message)
        mine = rows.setdefault((kind, size), [])
        places.append((list(rows).index((kind, size)), len(mine)))
        mine.append(plain[at : at + size])
        at += size
    blocks = [checked_corners(kind, np.array(cells, np.int64), n_points) for (kind, _), cells in rows.items()]
    return blocks, np.array(places, np.int64).reshape(-1, 2)


def _attribute(items: "_Items", attribute: Any, grid: Grid, cells: tuple[list[Block], IntArray] | None) -> None:
    """Keep values at the points, and the tags of cells as node sets; values of other kinds are passed over."""
    name, centre = attribute.get("Name", ""), attribute.get("Center", "Node")
    item = attribute.find("DataItem")
    if item is None or attribute.get("ItemType") == "FiniteElementFunction" or centre not in ("Node", "Cell"):
        return
    values = items.array(item)
    if centre == "Node" and len(values) == len(grid.points):
        grid.point_data[name] = values if values.ndim == 2 and values.shape[1] > 1 else np.ravel(values)
        return
    tags = np.ravel(values)
    if centre == "Node" or cells is None or len(tags) != len(cells[1]) or not _whole(tags):
        return
    kinds = np.unique(tags)
    if len(kinds) > _MOST_TAGS:
        return
    flags = set(kinds.tolist()) <= {0, 1}
    for tag in kinds.tolist():
        if flags and tag == 0:
            continue
        chosen = cells[1][tags == tag]
        nodes = [block.corners[chosen[chosen[:, 0] == i, 1]].ravel() for i, block in enumerate(cells[0])]
        grid.node_sets[name if flags else f"{name}_{int(tag)}"] = np.unique(np.concatenate(nodes))


def _whole(tags: npt.NDArray[Any]) -> bool:
    """Return whether tags are whole numbers; older files write them as real numbers."""
    return tags.dtype.kind in "iu" or bool(np.isfinite(tags).all() and (tags == np.floor(tags)).all())


class _Items:
    """The arrays that an XDMF file names; HDF5 files lie beside it and are opened once."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._open: dict[str, Any] = {}

    def __enter__(self) -> "_Items":
        return self

    def __exit__(self, *_: object) -> None:
        for opened in self._open.values():
            opened.close()

    def array(self, item: Any) -> npt.NDArray[Any]:
        """Return the numbers of a data item, in its shape."""
        form = "" if item is None else (item.get("Format") or "XML").upper()
        kind = "" if item is None else item.get("ItemType", "Uniform")
        if item is not None and (kind != "Uniform" or item.get("Reference") is not None):
            message = f"arrays must stand where they are used, as they are; got one by reference, or of the type {kind}"
            raise FormatError(message)
        if form == "XML":
            kind = (item.get("NumberType") or item.get("DataType") or "Float").lower()
            numbers = text_numbers(item.text or "", "i8" if "int" in kind or "char" in kind else "f8")
            words = (item.get("Dimensions") or "").split()
            shape = [int(word) for word in words] if all(word.isdecimal() for word in words) else []
            return numbers.reshape(shape) if shape and np.prod(np.array(shape, float)) == numbers.size else numbers
        if form != "HDF":
            message = f"arrays must be in the text (XML) or in HDF5 (HDF), got '{form}'"
            raise FormatError(message)
        name, _, path = (item.text or "").strip().partition(":")
        return self._of_hdf5(name, path)

    def _of_hdf5(self, name: str, path: str) -> npt.NDArray[Any]:
        import h5py

        if name not in self._open:
            self._open[name] = h5py.File(existing_file(self._file.parent / name, FILES.mesh_mb), "r", locking=False)
        found = own_dataset(self._open[name], name, path)
        if found is None or found.dtype.kind not in "biuf":
            message = f"{name} must hold numbers at '{path}', which {self._file} names; it does not"
            raise FormatError(message)
        size = int(np.prod(np.array(found.shape, object))) * found.dtype.itemsize
        if size > FILES.unpacked_mb * 1_000_000:
            raise too_large(self._file.parent / name, FILES.unpacked_mb, f"'{path}' would have {size / 1e6:.0f} MB")
        return np.asarray(found[()])
