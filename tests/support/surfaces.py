"""Surfaces that tests fill, whole ones and broken ones."""

import numpy as np


def sphere(radius: float = 20.0, centre=(0.0, 0.0, 0.0), subdivisions: int = 2):
    """Return vertices and outward triangles of an icosphere."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(ball.vertices) + np.asarray(centre), np.asarray(ball.faces, np.int64)


def box(lengths=(20.0, 20.0, 40.0), corner=(0.0, 0.0, 0.0)):
    """Return vertices and outward triangles of a box."""
    import trimesh

    solid = trimesh.creation.box(lengths)
    return np.asarray(solid.vertices) + np.asarray(lengths) / 2 + np.asarray(corner), np.asarray(solid.faces, np.int64)


def together(*surfaces):
    """Return several surfaces as one list of triangles."""
    offset, vertices, triangles = 0, [], []
    for points, corners in surfaces:
        vertices.append(points)
        triangles.append(corners + offset)
        offset += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def inverted(surface):
    """Return the surface with all normals reversed."""
    return surface[0], surface[1][:, [0, 2, 1]]


def without(surface, which):
    """Return the surface without some triangles."""
    kept = np.ones(len(surface[1]), bool)
    kept[which] = False
    return surface[0], surface[1][kept]


def write_stl(path, surface, head: bytes = b"", scale: float = 1.0):
    """Write a binary .stl."""
    corners = (np.asarray(surface[0]) * scale)[surface[1]].astype("<f4")
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = corners
    path.write_bytes(head.ljust(80, b" ")[:80] + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return path


def volume(surface):
    """Return the volume that a closed surface encloses."""
    a, b, c = (surface[0][surface[1][:, i]] for i in range(3))
    return np.einsum("ij,ij->", np.cross(a, b), c) / 6.0
