"""Bodies: a half ball, pressed radially into a smooth shape, and tetrahedra in it.

A cube of bricks sits in the middle, shells of bricks lie around it up to the surface (an "O-grid"); bricks become six
tetrahedra each. Mesh for the user and mesh for the data differ in numbers, rotation, refinement and order.
"""

from dataclasses import dataclass

import numpy as np

CORE = 0.5


@dataclass(frozen=True)
class Shape:
    """A body over the plane z = 0: everything inside radius(direction).

    Parameters
    ----------
    axes : tuple of float
        Half lengths along x, y, z in mm.
    power : float
        2: half ellipsoid; 3 or 4: block with round edges.
    waves : tuple of tuple of float
        Each (amplitude, x, y, z): the radius is multiplied by 1 + amplitude sin(direction . (x, y, z)).
    """

    axes: tuple[float, float, float]
    power: float = 2.0
    waves: tuple[tuple[float, float, float, float], ...] = ()

    def radius(self, directions):
        """Return the distance of the surface from the origin along unit vectors (..., 3), mm."""
        size = (np.abs(directions / np.asarray(self.axes)) ** self.power).sum(axis=-1) ** (-1.0 / self.power)
        for amplitude, *wave in self.waves:
            size = size * (1.0 + amplitude * np.sin(directions @ np.asarray(wave)))
        return size

    def on_surface(self, points):
        """Return points (..., 3) moved radially onto the free surface."""
        directions = points / np.linalg.norm(points, axis=-1, keepdims=True)
        return directions * self.radius(directions)[..., None]

    def in_body(self, points):
        """Return points (..., 3) of the unit half ball placed in the body."""
        size = np.linalg.norm(points, axis=-1, keepdims=True)
        directions = np.where(size > 0, points / np.where(size > 0, size, 1.0), [0.0, 0.0, 1.0])
        return points * self.radius(directions)[..., None]

    def depth(self, points):
        """Return how deep points (..., 3) lie below the free surface, mm."""
        from scipy.spatial import KDTree

        count = 40000
        i = np.arange(count) + 0.5
        z = i / count
        angle = np.pi * (1 + 5**0.5) * i
        ball = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1)
        return KDTree(self.on_surface(ball)).query(points.reshape(-1, 3))[0].reshape(points.shape[:-1])


def half_ball(n_across, n_up, n_shells, turn=0.0, bulge=0.6):
    """Return corners (n, 3) and bricks (m, 8) of the unit half ball.

    Parameters
    ----------
    n_across, n_up, n_shells : int
        Bricks along the sides of the inner cube, along its height, and from the cube to the surface.
    turn : float
        Rotation about z, radians.
    bulge : float
        How far the cube is rounded: 0 not, 1 to a ball.
    """
    across, up = np.linspace(-1, 1, n_across + 1), np.linspace(0, 1, n_up + 1)
    cube = np.stack(np.meshgrid(across, across, up, indexing="ij"), axis=-1)
    number = np.arange(cube[..., 0].size).reshape(cube.shape[:-1])
    flat = cube.reshape(-1, 3)
    points = [CORE * ((1 - bulge) * 0.8 * flat + bulge * _to_ball(flat))]
    bricks = [_bricks(number)]
    count = len(flat)
    outer = np.abs(flat).max(axis=1) > 1 - 1e-9
    outer &= ~((flat[:, 2] < 1e-9) & (np.abs(flat[:, :2]).max(axis=1) < 1 - 1e-9))
    skin = np.flatnonzero(outer)
    index = np.full((n_shells + 1, count), -1)
    index[0, skin] = skin
    start, end = points[0][skin], _to_ball(flat[skin])
    shares = np.arange(1, n_shells + 1) / n_shells
    points += [(1 - share) * start + share * end for share in shares]
    for shell in range(1, n_shells + 1):
        index[shell, skin] = count + np.arange(len(skin)) + (shell - 1) * len(skin)
    for face in (number[0], number[-1], number[:, 0], number[:, -1], number[:, :, -1]):
        bricks += [_bricks(index[:, face])]
    corners, cells = np.concatenate(points), np.concatenate(bricks)
    c, s = np.cos(turn), np.sin(turn)
    return corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]), cells


def _to_ball(cube):
    """Return points of the cube |p|_max <= 1 in the unit ball, shells of cubes to shells of balls."""
    size = np.abs(cube).max(axis=1, keepdims=True)
    face = np.tan(np.pi / 4 * np.divide(cube, size, out=np.zeros_like(cube), where=size > 0))
    length = np.linalg.norm(face, axis=1, keepdims=True)
    return size * np.divide(face, length, out=np.zeros_like(face), where=length > 0)


def _bricks(number):
    a = number
    corners = [
        a[i : a.shape[0] - 1 + i, j : a.shape[1] - 1 + j, k : a.shape[2] - 1 + k]
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    ]
    return np.stack([c.ravel() for c in corners], axis=1)


#: The six faces of a brick as cycles of its corners (corner number = 4 i + 2 j + k).
_FACES = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])


def tets_from_bricks(points, bricks, rng):
    """Return tetrahedra (m, 4) of positive volume, six a brick.

    Every face is cut through its corner of lowest rank, ranks drawn at random; the brick is a cone from its lowest one.
    """
    rank = rng.permutation(len(points))
    tets = []
    for brick in bricks:
        apex = brick[np.argmin(rank[brick])]
        for face in brick[_FACES]:
            if apex in face:
                continue
            first = int(np.argmin(rank[face]))
            a, b, c, d = np.roll(face, -first)
            tets += [(apex, a, b, c), (apex, a, c, d)]
    tets = np.array(tets)
    flip = volumes(points, tets) < 0
    tets[flip] = tets[flip][:, [0, 1, 3, 2]]
    return tets


def volumes(points, tets):
    """Return the volumes (m,) of tetrahedra."""
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    return np.linalg.det(edges) / 6.0


def boundary_triangles(tets):
    """Return the triangles (k, 3) that belong to one tetrahedron only."""
    faces = np.concatenate([tets[:, [1, 2, 3]], tets[:, [0, 3, 2]], tets[:, [0, 1, 3]], tets[:, [0, 2, 1]]])
    key = np.sort(faces, axis=1)
    _, first, counts = np.unique(key, axis=0, return_index=True, return_counts=True)
    return faces[first[counts == 1]]


def jittered(shape, ball, tets, rng, share):
    """Return the nodes (n, 3) of the body's mesh with nodes moved at random by a share of their shortest edge.

    Surface nodes stay on the surface, nodes of the base on the base, the rim on both; no tetrahedron loses more than
    four fifths of its volume.
    """
    triangles = boundary_triangles(tets)
    flat_face = np.abs(ball[triangles][:, :, 2]).max(axis=1) < 1e-9
    base = np.unique(triangles[flat_face])
    skin = np.unique(triangles[~flat_face])
    plain = shape.in_body(ball)
    edges = np.concatenate([tets[:, p] for p in ([0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3])])
    length = np.linalg.norm(plain[edges[:, 0]] - plain[edges[:, 1]], axis=1)
    shortest = np.full(len(plain), np.inf)
    for side in (0, 1):
        np.minimum.at(shortest, edges[:, side], length)
    step = rng.normal(size=plain.shape) * (share / np.sqrt(3) * shortest)[:, None]
    step[base, 2] = 0.0
    before = volumes(plain, tets)
    while True:
        moved = plain + step
        moved[skin] = shape.on_surface(moved[skin])
        moved[base, 2] = 0.0
        bad = volumes(moved, tets) < 0.2 * before
        if not bad.any():
            return moved
        step[np.unique(tets[bad])] *= 0.5
