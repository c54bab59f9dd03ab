"""Surfaces in ``.stl``, binary or text: triangles with corners of their own, of one body or of several."""

import re
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError

_HEAD_BYTES = 80
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


def read_stl(file: Path) -> tuple[FloatArray, IntArray, list[str]]:
    """Return the vertices (n, 3) of a .stl, joined where they are equal, its triangles (m, 3), and its headers.

    `file`: an existing .stl. It is binary if it is as long as its number of triangles requires, whatever it begins
    with. Raises `FormatError` if it is neither kind, or ends within a triangle or a body.
    """
    data = file.read_bytes()
    head, rows = data[:_HEAD_BYTES], data[_HEAD_BYTES + 4 :]
    if len(data) >= _HEAD_BYTES + 4 and len(rows) == _ROW.itemsize * int.from_bytes(data[_HEAD_BYTES:][:4], "little"):
        corners, notes = np.frombuffer(rows, _ROW)["corners"].astype(np.float64), [head.decode("latin-1")]
    else:
        corners, notes = _of_text(file, data)
    vertices, triangles = corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3)
    # Coordinates that are not finite are refused by the caller; joining them would take long.
    return (*(_joined(vertices, triangles) if np.isfinite(vertices).all() else (vertices, triangles)), notes)


def _of_text(file: Path, data: bytes) -> tuple[FloatArray, list[str]]:
    corners: list[list[list[float]]] = []
    loop: list[list[float]] | None = None
    notes: list[str] = []
    is_open = False
    for number, line in enumerate(re.split("\r\n|\n|\r", data.removeprefix(b"\xef\xbb\xbf").decode("latin-1")), 1):
        words = line.split()
        word = words[0].lower() if words else ""
        if word == "solid":
            notes.append(line)
            is_open = True
        elif word == "outer" and loop is None:
            loop = []
        elif word == "vertex" and loop is not None and len(words) == 4:
            loop.append(_place(file, number, words[1:]))
        elif word == "endloop" and loop is not None and len(loop) == 3:
            corners.append(loop)
            loop = None
        elif word == "endsolid" and loop is None:
            is_open = False
        elif word in ("outer", "vertex", "endloop", "endsolid"):
            message = f"a facet must be an outer loop of three vertices, x y z; it is not at {file} line {number}"
            raise FormatError(message, where=f"{file}:{number}")
    if is_open or loop is not None or not notes:
        message = f"{file} must be solids that end with 'endsolid', or binary; its last one does not end"
        raise FormatError(message, where=str(file))
    return np.array(corners, np.float64).reshape(-1, 3, 3), notes


def _place(file: Path, number: int, words: list[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        message = f"a vertex must be three numbers, got '{' '.join(words)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}") from None


def _joined(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Merge equal vertices; return the vertices (k, 3), ordered by first occurrence, and the triangles (m, 3)."""
    _, first, of_vertex = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[of_vertex.reshape(-1)[triangles]]
