"""Surfaces in ``.off`` (Geomview's object file format) as text: vertices and faces of any number of corners."""

import re
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.polygons import cut_listed

#: Heads of files in three dimensions; coordinates of textures, colours and normals may stand behind those of a vertex.
_HEAD = re.compile(r"(ST)?C?N?OFF$")


def read_off(file: Path) -> tuple[FloatArray, IntArray, list[str]]:
    """Return the vertices (n, 3) of an .off, its faces as triangles (m, 3), and its comments.

    `file`: an existing .off. Raises `FormatError` if it is of another kind, or does not hold what its second line says;
    the message names the line.
    """
    text = file.read_bytes().decode("latin-1").removeprefix("\xef\xbb\xbf")
    bare = [line.partition("#")[0].split() for line in re.split("\r\n|\n|\r", text)]
    lines = [(number, words) for number, words in enumerate(bare, 1) if words]
    head = lines[0][1] if lines else [""]
    if not _HEAD.match(head[0]) or head[1:2] == ["BINARY"]:
        message = f"{file} must begin with OFF (or COFF, NOFF, STOFF) and be text, got '{' '.join(head[:2])}'"
        raise FormatError(message, where=f"{file}:1")
    del head[0]
    (number, counts), *rest = lines if lines[0][1] else (lines[1:] or [(len(bare), [])])
    n_vertices, n_faces = _whole(file, number, counts, "numbers of vertices and faces", 2)[:2]
    if n_vertices < 0 or n_faces < 0 or len(rest) != n_vertices + n_faces:
        message = f"{file} must hold {n_vertices} vertices and {n_faces} faces, a line each; it holds {len(rest)} lines"
        raise FormatError(message, where=f"{file}:{number}")
    vertices = np.array([_place(file, *line) for line in rest[:n_vertices]], np.float64).reshape(-1, 3)
    faces = [_face(file, *line, n_vertices) for line in rest[n_vertices:]]
    return vertices, cut_listed(vertices, faces), re.findall("#[^\r\n]*", text)


def _whole(file: Path, number: int, words: list[str], what: str, least: int) -> list[int]:
    try:
        found = [int(word) for word in words]
    except ValueError:
        found = []
    if len(found) < least:
        message = f"the {what} must be whole numbers, {least} or more, got '{' '.join(words)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}")
    return found


def _place(file: Path, number: int, words: list[str]) -> list[float]:
    try:
        x, y, z = (float(word) for word in words[:3])
    except ValueError:
        message = f"a vertex must be three numbers, got '{' '.join(words)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}") from None
    return [x, y, z]


def _face(file: Path, number: int, words: list[str], n_vertices: int) -> list[int]:
    """Return the vertex indices of a face, which its line names after their number; a colour may follow."""
    length = int(words[0]) if words[0].isdecimal() else 0
    face = _whole(file, number, words[1 : length + 1], "vertices of a face", max(3, length))
    if not 0 <= min(face) <= max(face) < n_vertices:
        message = f"a face must name vertices 0 to {n_vertices - 1}, got '{' '.join(words)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}")
    return face
