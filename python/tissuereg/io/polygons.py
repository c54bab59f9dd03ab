"""Faces of any number of corners, as files of surfaces hold them, cut into triangles."""

from collections.abc import Iterator, Sequence

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.errors import FormatError, MeshError

#: Least area of a triangle of a fan, as a share of its face's, for it to be no sliver.
_LEAST_SHARE = 1e-9

#: Largest number of corners of a face that is cut ear by ear; the cost grows with its square.
_MOST_CORNERS = 2_000


def cut_listed(vertices: FloatArray, faces: Sequence[Sequence[int]]) -> IntArray:
    """Return faces, each a list of vertex indices of any length, as triangles (m, 3); see `cut`."""
    by_length: dict[int, list[Sequence[int]]] = {}
    for face in faces:
        by_length.setdefault(len(face), []).append(face)
    parts = [cut(vertices, np.array(by_length[length], np.int64)) for length in sorted(by_length)]
    return np.concatenate([np.empty((0, 3), np.int64), *parts])


def cut(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Return faces of equally many corners as triangles, none of them turned over against its face.

    `vertices` (n, 3); `faces` int (k, c): vertex indices, in order round each face, which may be hollow but does not
    cross itself. Result: (k * (c - 2), 3). Raises `MeshError` if an index is out of range; `FormatError` if a hollow
    face has too many corners.

    >>> corners = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [3, 1, 0]])
    >>> cut(corners, np.array([[0, 1, 2, 3]])).tolist()
    [[3, 0, 1], [1, 2, 3]]
    """
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        bad = faces.min() if faces.min() < 0 else faces.max()
        message = f"faces must name vertices 0 to {len(vertices) - 1}, got {bad}"
        raise MeshError(message, where="triangles")
    if faces.shape[1] <= 3:
        if faces.shape[1] < 3 and len(faces):
            message = f"faces must have three corners or more; {len(faces)} have {faces.shape[1]}"
            raise FormatError(message, where="faces")
        return faces.reshape(-1, 3)
    corners = np.arange(1, faces.shape[1] - 1)
    fans = np.stack(
        [np.broadcast_to(faces[:, :1], (len(faces), len(corners))), faces[:, corners], faces[:, corners + 1]]
    )
    triangles: IntArray = np.moveaxis(fans, 0, 2).copy()
    with np.errstate(all="ignore"):  # numbers near the largest overflow; nothing is hollow about them
        for row in np.flatnonzero(_hollow(vertices[faces])):
            triangles[row] = faces[row][list(_ears(_flat(vertices[faces[row]])))]
    return triangles.reshape(-1, 3)


def _hollow(places: FloatArray) -> BoolArray:
    """Return a mask (k,) of the faces, corners (k, c, 3), that a fan from their first corner does not cut well."""
    arms = places[:, 1:] - places[:, :1]
    normals = np.cross(arms[:, :-1], arms[:, 1:])
    whole = normals.sum(axis=1)
    size = np.einsum("kx,kx->k", whole, whole)
    worst = np.einsum("kcx,kx->kc", normals, whole).min(axis=1)
    return np.asarray((worst <= _LEAST_SHARE * size) & (size > 0.0) & np.isfinite(size))


def _flat(places: FloatArray) -> FloatArray:
    """Return the corners (c, 3) of a face in its own mean plane, (c, 2), so that they go round to the left."""
    arms = places - places.mean(axis=0)
    normal = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return np.asarray(arms @ np.column_stack([first, np.cross(normal, first)]))


def _ears(places: FloatArray) -> Iterator[list[int]]:
    """Yield the corners of triangles that fill a polygon (c, 2) that goes round to the left, one ear after another."""
    if len(places) > _MOST_CORNERS:
        message = f"a hollow face must have at most {_MOST_CORNERS} corners, got {len(places)}; cut it into triangles"
        raise FormatError(message, where="faces")
    left = list(range(len(places)))
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(places, left, i)), None)
        if ear is None:  # corners on one line only, or a face that crosses itself
            ear = int(np.argmin(np.abs(_areas(places, left))))
        yield [left[ear - 1], left[ear], left[(ear + 1) % len(left)]]
        del left[ear]
    yield left


def _areas(places: FloatArray, left: list[int]) -> FloatArray:
    """Return twice the signed area of the triangle of each corner in `left` and its neighbours."""
    at = places[left]
    return _double_area(np.roll(at, 1, axis=0), at, np.roll(at, -1, axis=0))


def _is_ear(places: FloatArray, left: list[int], i: int) -> bool:
    """Return whether corner `i` of those left turns left, and its triangle with its neighbours holds no other."""
    before, here, after = (places[left[j % len(left)]] for j in (i - 1, i, i + 1))
    area = _double_area(before, here, after)
    if area <= _LEAST_SHARE * float(np.ptp(places, axis=0).max()) ** 2:
        return False
    others = places[[corner for j, corner in enumerate(left) if (j - i) % len(left) not in (0, 1, len(left) - 1)]]
    sides = [_double_area(a, b, others) for a, b in ((before, here), (here, after), (after, before))]
    within = (np.array(sides) >= 0.0).all(axis=0)
    # A corner at the place of one of the three does not stand in the way: a hole is joined to the rim by such.
    same = (others[:, None] == np.stack([before, here, after])).all(axis=2).any(axis=1)
    return not (within & ~same).any()


def _double_area(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    one, other = b - a, c - a
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
