"""Surfaces in Wavefront's ``.obj``: vertices and faces of any number of corners, of one object or of several."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.polygons import cut_listed


def read_obj(file: Path) -> tuple[FloatArray, IntArray, list[str]]:
    """Return the vertices (n, 3) of an .obj, the triangles (m, 3) of all its objects, and its comments.

    `file`: an existing .obj. Corners of a face are given as ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; a negative
    number counts back from the vertex before the face. Raises `FormatError` if a line is spoilt, or holds a free-form
    surface or the name of another file, which would be lost; the message names the line.
    """
    places: list[list[float]] = []
    faces: list[list[int]] = []
    lines: list[int] = []
    text = file.read_bytes().decode("latin-1").removeprefix("\xef\xbb\xbf")
    for number, words in _statements(text):
        if words[0] == "v":
            places.append(_place(file, number, words[1:4]))
        elif words[0] in ("f", "fo"):
            faces.append(_face(file, number, words[1:], len(places)))
            lines.append(number)
        elif words[0] == "surf":
            message = f"{file} must be made of faces; it holds a free-form surface at line {number}"
            raise FormatError(message, where=f"{file}:{number}")
        elif words[0] == "call":
            message = f"{file} must hold all its faces itself; at line {number} it takes in those of another file"
            raise FormatError(message, where=f"{file}:{number}")
    for number, face in zip(lines, faces, strict=True):
        if not 0 <= min(face) <= max(face) < len(places):
            where = f"{file} line {number}"
            message = f"a face must name vertices 1 to {len(places)}, or -1 and so on backwards; it does not at {where}"
            raise FormatError(message, where=f"{file}:{number}")
    vertices = np.array(places, np.float64).reshape(-1, 3)
    return vertices, cut_listed(vertices, faces), re.findall("#[^\r\n]*", text)


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of each line that is not empty, without comments; a backslash joins it to the next."""
    before: list[str] = []
    for number, line in enumerate(re.split("\r\n|\n|\r", text), 1):
        bare = line.partition("#")[0].rstrip()
        words = [*before, *bare.removesuffix("\\").split()]
        before = words if bare.endswith("\\") else []
        if words and not before:
            yield number, words


def _place(file: Path, number: int, words: list[str]) -> list[float]:
    try:
        x, y, z = (float(word) for word in words)
    except ValueError:
        message = f"a vertex must be three numbers, got '{' '.join(words)}' at {file} line {number}"
        raise FormatError(message, where=f"{file}:{number}") from None
    return [x, y, z]


def _face(file: Path, number: int, words: list[str], n_before: int) -> list[int]:
    """Return the vertex indices, from 0, of a face of which `n_before` vertices stand before it."""
    try:
        named = [int(word.partition("/")[0]) for word in words]
    except ValueError:
        named = []
    if len(named) < 3 or 0 in named:
        message = (
            f"a face must name three vertices or more, each as v, v/vt, v//vn or v/vt/vn, got '{' '.join(words)}' at "
            f"{file} line {number}"
        )
        raise FormatError(message, where=f"{file}:{number}")
    return [n_before + one if one < 0 else one - 1 for one in named]
