"""Bodies by Open Cascade: sizes drawn, and the ways in which each can be held."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from netgen.occ import Axes, Axis, Box, Cylinder, Ellipsoid, HalfSpace, Pnt, WorkPlane, X, Y, Z, gp_Dir

from rigs.generator.meshing import skin_of


@dataclass
class Body:
    """A solid on the plane z = 0.

    `solid`: Open Cascade's shape; `kind`: its name; `low`, `high` (3,): the box around it, mm; `holds`: supports that
    suit it, of base, part, ends, side.
    """

    solid: object
    kind: str
    low: np.ndarray
    high: np.ndarray
    holds: tuple

    @property
    def size(self):
        """Mean of the three lengths of the box around it, mm."""
        return float(np.mean(self.high - self.low))

    @cached_property
    def skin(self):
        """Centres, outward normals and corners of small triangles of the skin."""
        return skin_of(self.solid, 3.0)


def _body(solid, kind, holds):
    _, _, corners = skin_of(solid, 8.0)
    corners = np.round(corners.reshape(-1, 3), 4)
    return Body(solid, kind, corners.min(axis=0), corners.max(axis=0), holds)


def _block(rng):
    size = np.round(rng.uniform([55, 45, 32], [110, 85, 60]), 1)
    return _body(Box(Pnt(0, 0, 0), Pnt(*size)), "box", ("base", "part", "side"))


def _slab(rng):
    size = np.round(rng.uniform([90, 70, 30], [150, 110, 38]), 1)
    return _body(Box(Pnt(0, 0, 0), Pnt(*size)), "slab", ("base", "part", "ends"))


def _bar(rng):
    size = np.round(rng.uniform([100, 32, 30], [150, 48, 42]), 1)
    return _body(Box(Pnt(0, 0, 0), Pnt(*size)), "bar", ("ends", "side"))


def _cylinder(rng):
    radius, height = np.round(rng.uniform([26, 38], [45, 85]), 1)
    return _body(Cylinder(Pnt(0, 0, 0), Z, radius, height), "cylinder", ("base",))


def _cone(rng):
    low, high, height = np.round(rng.uniform([32, 18, 40], [50, 28, 75]), 1)
    half = _polygon([(0, 0), (low, 0), (high, height), (0, height)], 0.0)
    return _body(half.Revolve(Axis(Pnt(0, 0, 0), Z), 360), "cone", ("base",))


def _dome(rng):
    a, b, c = np.round(rng.uniform([42, 36, 32], [62, 55, 55]), 1)
    # The first half-axis goes along the normal.
    ball = Ellipsoid(Axes(Pnt(0, 0, 0), n=Z, h=X), c, a, b)
    return _body(ball * HalfSpace(Pnt(0, 0, 0), gp_Dir(0, 0, -1)), "dome", ("base", "part"))


def _polygon(corners, depth):
    """Return a polygon in the plane of x and z, drawn out along y."""
    # Local axes (x, z); the normal of the plane is -y.
    plane = WorkPlane(Axes(Pnt(0, depth, 0), n=-Y, h=X)).MoveTo(*corners[0])
    for corner in corners[1:]:
        plane = plane.LineTo(*corner)
    face = plane.Close().Face()
    return face.Extrude(depth) if depth else face


def _ell(rng):
    long, high, thick, depth = np.round(rng.uniform([70, 60, 28, 40], [105, 90, 38, 60]), 1)
    corners = [(0, 0), (long, 0), (long, thick), (thick, thick), (thick, high), (0, high)]
    return _body(_polygon(corners, depth), "ell", ("base", "side"))


def _wedge(rng):
    long, tall, low, depth = np.round(rng.uniform([70, 48, 16, 45], [110, 70, 26, 75]), 1)
    return _body(_polygon([(0, 0), (long, 0), (long, low), (0, tall)], depth), "wedge", ("base", "part", "side"))


def _hexagon(rng):
    radius, depth = np.round(rng.uniform([28, 50], [40, 90]), 1)
    angles = np.deg2rad([240, 300, 0, 60, 120, 180])
    rise = radius * np.sin(np.pi / 3)
    corners = [(radius * np.cos(a), rise + radius * np.sin(a)) for a in angles]
    return _body(_polygon(corners, depth), "hexagon", ("base",))


def _arch(rng):
    outer, thick, depth = np.round(rng.uniform([50, 24, 34], [68, 32, 50]), 1)
    ring = Cylinder(Pnt(0, 0, 0), Y, outer, depth) - Cylinder(Pnt(0, -1, 0), Y, outer - thick, depth + 2)
    return _body(ring * HalfSpace(Pnt(0, 0, 0), gp_Dir(0, 0, -1)), "arch", ("base",))


def _loaf(rng):
    radius, long, cut = np.round(rng.uniform([30, 70, 0.2], [46, 115, 0.6]), 1)
    log = Cylinder(Pnt(0, 0, cut * radius), X, radius, long)
    return _body(log * HalfSpace(Pnt(0, 0, 0), gp_Dir(0, 0, -1)), "loaf", ("base", "ends"))


DRAWN = {
    "box": _block,
    "slab": _slab,
    "bar": _bar,
    "cylinder": _cylinder,
    "cone": _cone,
    "dome": _dome,
    "ell": _ell,
    "wedge": _wedge,
    "hexagon": _hexagon,
    "arch": _arch,
    "loaf": _loaf,
}


def box_of(size):
    """Return a box of given lengths, mm."""
    return _body(Box(Pnt(0, 0, 0), Pnt(*size)), "box", ("base",))
