"""Writing of surfaces of triangles in mm: .stl and .ply (binary) and .obj, with their patient frame if they have one.

An .stl repeats its vertices for every triangle; .ply and .obj keep them in their order.
"""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError
from tissuereg.io.atomic import atomic_file


def check_surface_target(path: str | os.PathLike[str]) -> Path:
    """Return a path to which a surface can be written; raise `FormatError` if its name ends otherwise."""
    file = Path(path)
    if file.suffix.lower() not in _WRITERS:
        message = f"a surface's name must end in one of {', '.join(_WRITERS)}, got '{file}'"
        raise FormatError(message, where=str(file))
    return file


def write_triangles(path: str | os.PathLike[str], surface: Triangles) -> None:
    """Write a surface, whole or not at all."""
    file = check_surface_target(path)
    content = _WRITERS[file.suffix.lower()](surface)
    with atomic_file(file) as draft:
        draft.write_bytes(content)


def _notes(surface: Triangles) -> list[str]:
    return ["unit: mm", *([f"SPACE={surface.frame}"] if surface.frame else [])]


def _stl(surface: Triangles) -> bytes:
    corners = surface.vertices[surface.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["normal"] = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    facets["corners"] = corners
    head = f"tissuereg, {', '.join(_notes(surface))}".encode("ascii")
    return bytes(head.ljust(80) + np.array(len(facets), "<u4").tobytes() + facets.tobytes())


def _ply(surface: Triangles) -> bytes:
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {note}" for note in _notes(surface)),
        f"element vertex {len(surface.vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(surface.triangles)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    faces = np.zeros(len(surface.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, surface.triangles
    return "\n".join(lines).encode("ascii") + surface.vertices.astype("<f8").tobytes() + faces.tobytes()


def _obj(surface: Triangles) -> bytes:
    lines = [f"# {note}" for note in _notes(surface)]
    lines += ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in surface.vertices]
    lines += ["f {} {} {}".format(*corners) for corners in surface.triangles + 1]
    return ("\n".join(lines) + "\n").encode("ascii")


_WRITERS: dict[str, Callable[[Triangles], bytes]] = {".stl": _stl, ".ply": _ply, ".obj": _obj}

__all__ = ["check_surface_target", "write_triangles"]
